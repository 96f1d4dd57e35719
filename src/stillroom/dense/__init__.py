"""Sieve 3 and what it leaves: a dense map of what stays."""
