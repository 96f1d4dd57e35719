"""Stillroom: where an RGB-D camera was in a room full of people, and a map of what stays."""

import os as _os

from stillroom.data.locations import cache_folder as _cache_folder

__version__ = "0.1.0"

# Numba reads this variable when it is first imported, so it is set here, before any kernel can be. The version is part
# of the path because numba asks only of a kernel's own file whether it changed, not of the files of those it calls.
_os.environ.setdefault("NUMBA_CACHE_DIR", str(_cache_folder() / "numba" / __version__))
