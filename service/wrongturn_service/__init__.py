"""Wrongturn's HTTP service: agents, episodes on a pool of simulators, verdicts, storage and the leaderboard."""
