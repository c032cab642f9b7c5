"""Old places of entry points."""
