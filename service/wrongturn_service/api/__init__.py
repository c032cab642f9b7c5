"""The REST calls, one resource a file."""
