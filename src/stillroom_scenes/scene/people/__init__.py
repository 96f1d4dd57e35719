"""People: bodies, clothes, gait, and their paths."""
