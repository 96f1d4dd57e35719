"""Sieve 3 and its result: a dense map of the static scene."""
