"""Submissions: agents that were handed in as a model, which the service checks and drives itself."""
