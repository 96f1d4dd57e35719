"""Rooms rendered by the package itself: textured, furnished, peopled, and known to the last pixel.

`kind` is how they are opened, `config` says what can be chosen, `room` has the data set.
"""

PREFIX = "synthetic"
"""Before the colon in what a user asks for: `synthetic:walking`."""
