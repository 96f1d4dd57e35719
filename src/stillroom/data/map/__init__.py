"""The map is arrays with integer ids; keyframes and points are rows."""

from stillroom.data.map.map import Covisibility, Map

__all__ = ["Covisibility", "Map"]
