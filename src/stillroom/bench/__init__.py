"""How good, how fast, and whether the sieve earns its place: the logic behind `stillroom bench`."""
