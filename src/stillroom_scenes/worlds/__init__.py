"""The places to be in: a single room, a ring of corridors, a building of rooms; each with a way for the camera."""
