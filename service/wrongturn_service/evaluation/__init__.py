"""Leaderboards, kept until an evaluation changes them, and rows of algorithms from other packages."""
