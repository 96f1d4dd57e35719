"""Nouns of depth clouds: what one image falls into, and the dense map as it leaves the house."""
