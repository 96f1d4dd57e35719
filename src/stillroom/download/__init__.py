"""Fetching data sets and networks from their own addresses, checked by hash where one is known."""

from stillroom.download.targets import OFFICIAL, PSPNET_R50, Addresses, Progress, download, fetch, no_progress

__all__ = ["OFFICIAL", "PSPNET_R50", "Addresses", "Progress", "download", "fetch", "no_progress"]
