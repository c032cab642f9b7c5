"""Drives one submission: the model in its sandbox, the episodes through the service's own calls."""

from typing import Final

SANDBOXES: Final = 2
"""Sandboxes of a submission that is driven, so that two episodes do not wait for each other."""
