"""Stillroom: where an RGB-D camera was in a room full of people, and a map of what stays."""

__version__ = "0.1.0"
