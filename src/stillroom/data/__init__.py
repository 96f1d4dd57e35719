"""The nouns of the system: what the rooms hand to each other."""
