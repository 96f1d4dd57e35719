"""Fetching data sets and weights from their own addresses, checked by hash where one is known."""

from stillroom.download.fetch import Progress, fetch, no_progress
from stillroom.download.targets import MODELS, OFFICIAL, Addresses, download, download_pspnet_r50

__all__ = ["MODELS", "OFFICIAL", "Addresses", "Progress", "download", "download_pspnet_r50", "fetch", "no_progress"]
