"""Telling that a place has been seen before: by looks, by staying power, by geometry."""
