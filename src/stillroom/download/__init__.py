"""Fetching data sets and weights from their own addresses, checked by hash where one is known."""

from stillroom.download.fetch import Progress, fetch, no_progress
from stillroom.download.targets import MODELS, OFFICIAL, Addresses, download

__all__ = ["MODELS", "OFFICIAL", "Addresses", "Progress", "download", "fetch", "no_progress"]
