"""Batches: which picture, how varied; decided by seed, step and process alone, so that learning can be resumed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stillroom.errors import DatasetError
from stillroom.geometry.arrays import F32
from stillroom_train.pspnet.pictures.example import KINDS, PEOPLE, ROOM, Example
from stillroom_train.pspnet.pictures.vary import varied, with_stranger
from stillroom_train.pspnet.recipe import Recipe


@dataclass(frozen=True, eq=False)
class Batch:
    """Views of several pictures.

    Attributes:
        rgb: Colours (N, 3, H, W) float32 in 0–255.
        classes: Probabilities (N, classes, h, w) float32.
        weight: 1 where they are known (N, h, w) float32.
    """

    rgb: F32
    classes: F32
    weight: F32


class Batches:
    """Makes any step's batch."""

    def __init__(self, examples: Sequence[Example], recipe: Recipe, seed: int, process: int = 0) -> None:
        """Sort the examples by kind.

        Raises:
            DatasetError: There are no pictures of people.
        """
        self._of_kind = {kind: [e for e in examples if e.kind == kind] for kind in KINDS}
        if not self._of_kind[PEOPLE]:
            raise DatasetError("no pictures of people to learn from")
        shares = np.array(
            [share if self._of_kind[kind] else 0.0 for kind, share in zip(KINDS, recipe.shares, strict=True)]
        )
        self._shares = shares / shares.sum()
        self._recipe = recipe
        self._crops = recipe.crops
        self._seed = seed
        self._process = process

    def at(self, step: int) -> Batch:
        """Return the batch of a step."""
        lot = np.random.default_rng((self._seed, step, self._process))
        crop = self._crops[step % len(self._crops)]
        views = [varied(self._drawn(lot), crop, self._recipe.variation, lot) for _ in range(self._recipe.batch)]
        return Batch(
            np.stack([view.rgb.transpose(2, 0, 1) for view in views]),
            np.stack([view.classes.transpose(2, 0, 1) for view in views]),
            np.stack([view.weight for view in views]),
        )

    def _drawn(self, lot: np.random.Generator) -> Example:
        kind = KINDS[int(lot.choice(len(KINDS), p=self._shares))]
        example = self._any(kind, lot)
        if kind == ROOM and lot.random() < self._recipe.variation.strangers:
            return with_stranger(example, self._any(PEOPLE, lot), lot)
        return example

    def _any(self, kind: str, lot: np.random.Generator) -> Example:
        return self._of_kind[kind][int(lot.integers(len(self._of_kind[kind])))]
