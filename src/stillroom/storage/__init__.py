"""The map on disk: one SQLite file, written as the map grows; docs/map-file.md describes it."""

from stillroom.storage.reader import load_map
from stillroom.storage.schema import FrameNote, Session, StoredMap
from stillroom.storage.writer import MapWriter, save_map

__all__ = ["FrameNote", "MapWriter", "Session", "StoredMap", "load_map", "save_map"]
