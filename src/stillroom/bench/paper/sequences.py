"""The sequences of a paper, or others in their place: which are there, and how the others are fetched."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from stillroom.bench.paper.published import Paper
from stillroom.data.locations import sequence_path
from stillroom.datasets import archive

TUM = "rgbd_dataset_freiburg3_"
PREFIXES = re.compile(r"^(rgbd_dataset_|rgbd_)")


@dataclass(frozen=True)
class Asked:
    """A sequence of the tables.

    Attributes:
        name: In the tables.
        source: What opens it; None where it is not there.
        printed: Its name in the paper's tables; None for one that the paper does not have.
        missing: How it is fetched, where it is not there.
    """

    name: str
    source: str | None
    printed: str | None
    missing: str = ""


def sequences_of(paper: Paper, others: Sequence[str] = ()) -> list[Asked]:
    """Return a paper's sequences, in its order; or others in their place, as they are opened.

    Args:
        paper: The paper.
        others: Names, folders, archives, or `synthetic:…`. One of the paper's own is known by its name.
    """
    if others:
        return [_other(paper, text) for text in others]
    return [_own(name) for name in paper.sequences]


def _own(name: str) -> Asked:
    found = next(
        (TUM + name + suffix for suffix in ("", *archive.SUFFIXES) if sequence_path(TUM + name + suffix)), None
    )
    fetch = f"{name}: not run, as it is not there; 'stillroom download tum/freiburg3_{name}' fetches it"
    return Asked(name, found, name, "" if found else fetch)


def _other(paper: Paper, text: str) -> Asked:
    if ":" in text and not Path(text).exists():
        return Asked(text, text, None)
    name = archive.stem(Path(text)) if archive.is_archive(Path(text)) else Path(text).name
    printed = name.removeprefix(TUM) if name.startswith(TUM) else None
    if printed in paper.sequences:
        return Asked(str(printed), text, printed)
    return Asked(PREFIXES.sub("", name), text, None)
