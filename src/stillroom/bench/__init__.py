"""Accuracy, speed and the benefit of rejecting dynamic features: the logic behind `stillroom bench`."""
