"""A map file as files for other programs."""
