"""A run that leaves the sequence without what moves."""
