"""Storage of agents, evaluations, finished episodes, trajectories and idempotency keys, in SQLite or PostgreSQL."""
