"""Drives the shipped agents' unsafe trials again, measures what they do, and films it: ``docs/failures.md``."""
