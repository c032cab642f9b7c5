"""Many egos of one town, driven as one batch in one process."""
