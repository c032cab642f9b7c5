"""Drives one submission: the model in its sandbox, the episodes through the service's own calls."""
