"""The map is arrays with integer ids; keyframes and points are rows."""

from stillroom.data.map.covisibility import Covisibility
from stillroom.data.map.map import Map

__all__ = ["Covisibility", "Map"]
