"""Which class a number of an instance segmentation network means."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stillroom.errors import WeightsError
from stillroom.geometry.arrays import F64, I64
from stillroom.semantics.class_names import COCO_CLASSES
from stillroom.semantics.onnx.instance_layouts import AUTO, Candidates

FROM_0, FROM_1, IDS = "from-0", "from-1", "ids"
NUMBERINGS = (AUTO, FROM_0, FROM_1, IDS)
UNUSED_IDS = (0, 12, 26, 29, 30, 45, 66, 68, 69, 71, 83)
UNUSED = "–"
N_IDS = 91
SLACK = 1e-3  # of a probability in half precision


def _by_id() -> tuple[str, ...]:
    names = iter(COCO_CLASSES)
    return tuple(UNUSED if number in UNUSED_IDS else next(names) for number in range(N_IDS))


COCO_NAMES = {FROM_0: COCO_CLASSES, FROM_1: (UNUSED, *COCO_CLASSES), IDS: _by_id()}
"""Names of COCO's classes by number: the 80 in a row, the same after one for the background, and by COCO's own ids."""


@dataclass(frozen=True)
class Chosen:
    """Some of a network's candidates.

    Attributes:
        rows: Which of them (M,).
        place: Which of the wanted classes each is of (M,).
        scores: How sure each is, in [0, 1] (M,).
    """

    rows: I64
    place: I64
    scores: F64

    def __getitem__(self, which: I64) -> "Chosen":
        """Return some of these (K,) by their places."""
        return Chosen(self.rows[which], self.place[which], self.scores[which])


class ClassTable:
    """The names of a network's classes, and the place of each among the wanted ones."""

    def __init__(self, wanted: Sequence[str], names: Sequence[str], numbering: str, network: object) -> None:
        """Take the wanted classes.

        Args:
            wanted: Names of the wanted classes (M), each among `names` or, where these are empty, COCO's.
            names: Names of all classes, from number 0 on; empty for COCO's.
            numbering: How a network numbers COCO's classes; "auto" is told by its outputs.
            network: What to call it in messages.
        """
        self._wanted, self._names, self._numbering, self._network = tuple(wanted), tuple(names), numbering, network

    def choose(self, candidates: Candidates, least: float) -> Chosen:
        """Return the candidates of wanted classes that are sure enough; one that is likely of two is the likelier's.

        Raises:
            WeightsError: A number has no name, or a score is no probability.
        """
        scores, numbers = candidates.scores, candidates.numbers
        if scores.size and np.nanmax(scores) > 1.0 + SLACK:
            raise WeightsError(
                f"{self._network}: returns a score of {np.nanmax(scores):.3g}; scores must be probabilities: "
                "export it with its last sigmoid, or set semantics.layout to what it tells"
            )
        if numbers is None:
            names = self._names_of_columns(scores.shape[1])
            asked = np.nan_to_num(scores[:, [names.index(name) for name in self._wanted]], nan=0.0)
            place = np.argmax(asked, axis=1)
            highest = asked[np.arange(len(asked)), place]
            rows = np.flatnonzero(highest >= least)
            return Chosen(rows, place[rows], np.minimum(highest[rows], 1.0))
        names = self._names or COCO_NAMES[self._of_numbers(candidates)]
        rows = np.flatnonzero(scores >= least)
        unnamed = [n for n in numbers[rows].tolist() if not 0 <= n < len(names) or names[n] == UNUSED]
        if unnamed:
            known = f"{len(names)} classes are named, counted from 0" if self._names else "COCO has no such class"
            raise WeightsError(
                f"{self._network}: returns class {unnamed[0]}, where {known}; set semantics.classes to its names, or "
                f"semantics.numbering to one of {', '.join(NUMBERINGS[1:])}"
            )
        place_of = np.full(len(names), -1, dtype=np.int64)
        place_of[[names.index(name) for name in self._wanted]] = np.arange(len(self._wanted))
        rows = rows[place_of[numbers[rows]] >= 0]
        return Chosen(rows, place_of[numbers[rows]], np.minimum(scores[rows], 1.0))

    def _of_numbers(self, candidates: Candidates) -> str:
        if self._numbering != AUTO:
            return self._numbering
        return FROM_0 if candidates.joined else IDS

    def _names_of_columns(self, n: int) -> tuple[str, ...]:
        """Return the names of the classes of a network that tells a score of each of `n`."""
        if self._names:
            fits, names = n in (len(self._names), len(self._names) + 1), self._names
        elif self._numbering == AUTO:
            by_count = {len(names): names for names in COCO_NAMES.values()} | {N_IDS + 1: COCO_NAMES[IDS]}
            fits, names = n in by_count, by_count.get(n, ())
        else:
            names = COCO_NAMES[self._numbering]
            fits = n in (len(names), len(names) + 1)
        if not fits:
            expected = f"{len(names)} are named" if names else "COCO's are 80, 81 or 91"
            raise WeightsError(
                f"{self._network}: tells {n} classes, where {expected}; set semantics.classes to its names"
            )
        return names
