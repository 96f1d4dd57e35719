"""What a method is: a named configuration."""

from dataclasses import dataclass

from stillroom.config import SlamConfig


@dataclass(frozen=True)
class Method:
    """A preset.

    Attributes:
        name: As given to `--method`; also the `method` of its config.
        summary: One line: how dynamic features are rejected.
        config: The whole configuration.
        paper: Where the method was published.
    """

    name: str
    summary: str
    config: SlamConfig
    paper: str = ""
