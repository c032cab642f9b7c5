"""Other road users: planned from a trial's seed, and driven by SUMO while an episode runs."""
