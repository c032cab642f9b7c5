"""Pictures of an episode for people: the town from above, the car's way, and what the car was told."""
