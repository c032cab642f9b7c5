"""Wrongturn's HTTP service: agents, episodes in simulators, storage and leaderboards."""
