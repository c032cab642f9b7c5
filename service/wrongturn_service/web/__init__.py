"""Pages for people, at the same address as the REST calls."""
