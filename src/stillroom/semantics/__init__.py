"""Segmenters: boxes and masks of what is potentially dynamic, such as people."""
