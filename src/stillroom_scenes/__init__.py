"""Rendered RGB-D sequences: textured, furnished rooms with people, and exact ground truth.

`kind` opens them, `config` has their options, `room` the data set.
"""

PREFIX = "synthetic"
"""Prefix of a sequence's name: `synthetic:walking`."""
