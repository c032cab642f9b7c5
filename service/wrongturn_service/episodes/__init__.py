"""Open episodes: what is kept of them, who may step them, and how they come back after a failure."""
