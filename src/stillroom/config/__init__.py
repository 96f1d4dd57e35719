"""The configuration tree, the kinds of parts that it can choose, and how it is read, written and overridden."""

from stillroom.config.settings import read_toml, to_toml, updated, with_overrides
from stillroom.config.tree import SlamConfig

__all__ = ["SlamConfig", "read_toml", "to_toml", "updated", "with_overrides"]
