"""Geometry on trial: what testing every point costs, what the ants save of it, and what each part is worth."""
