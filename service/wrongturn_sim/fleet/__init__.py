"""Many cars of one town, driven as one batch in one process."""
