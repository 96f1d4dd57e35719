"""The sparse map: arrays with integer ids, in which keyframes and points are rows."""

from stillroom.data.map.map import Covisibility, Map

__all__ = ["Covisibility", "Map"]
