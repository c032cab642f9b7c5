"""An OpenEnv server before a Wrongturn service, so that frameworks that speak OpenEnv can train on it.

``wrongturn openenv`` runs it, and ``docs/openenv.md`` shows its calls. OpenEnv's own package is not needed here: it is
what the trainers use.
"""
