"""The windowed search against all pairs, written plainly."""

from dataclasses import replace

import numpy as np
import pytest
from plain_search import search_windows_plainly

from stillroom.features.matching import Queries, Targets, search_windows


def targets_and_queries(seed: int, n: int = 400, q: int = 300, flips: int = 40) -> tuple[Targets, Queries]:
    """Keypoints in a small part of an image, and queries that are turned-over copies of some of them, near and far."""
    rng = np.random.default_rng(seed)
    px = (rng.uniform(0, 1, (n, 2)) * [160, 120]).astype(np.float32)
    descriptors = rng.integers(0, 256, (n, 32), dtype=np.uint8)
    # The second half has a rival in the first half: beside it, and almost the same to look at.
    px[n // 2 :] = px[: n - n // 2] + rng.normal(0, 3, (n - n // 2, 2))
    rivals = np.unpackbits(descriptors[: n - n // 2], axis=1) ^ (rng.random((n - n // 2, 256)) < 0.1)
    descriptors[n // 2 :] = np.packbits(rivals, axis=1)
    targets = Targets(
        px=px,
        octave=rng.integers(0, 3, n).astype(np.int32),
        right_px=np.where(rng.random(n) < 0.7, px[:, 0] - rng.uniform(0, 20, n), -1).astype(np.float32),
        descriptors=descriptors,
        usable=rng.random(n) < 0.8,
    )
    like = rng.integers(0, n, q)
    bits = np.unpackbits(descriptors[like], axis=1)
    for row in bits:
        row[rng.permutation(256)[: rng.integers(0, 2 * flips)]] ^= 1
    low = np.maximum(0, targets.octave[like] - rng.integers(0, 2, q))
    queries = Queries(
        px=(px[like] + rng.normal(0, 6, (q, 2))).astype(np.float32),
        radius_px=rng.uniform(3, 30, q).astype(np.float32),
        min_octave=low.astype(np.int32),
        max_octave=(low + rng.integers(0, 3, q)).astype(np.int32),
        right_px=np.where(rng.random(q) < 0.7, targets.right_px[like] + rng.normal(0, 6, q), -1).astype(np.float32),
        descriptors=np.packbits(bits, axis=1),
    )
    return targets, queries


def found(queries: Queries, targets: Targets, max_bits: int = 100, ratio: float = 1.0) -> dict[int, int]:
    query, target = search_windows(queries, targets, max_bits, ratio)
    assert len(np.unique(query)) == len(query)
    assert len(np.unique(target)) == len(target)
    return dict(zip(query.tolist(), target.tolist(), strict=True))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(("max_bits", "ratio"), [(100, 1.0), (50, 0.8), (30, 0.6), (100, 0.9)])
def test_matches_are_those_of_the_plain_search(seed: int, max_bits: int, ratio: float) -> None:
    targets, queries = targets_and_queries(seed)
    expected = search_windows_plainly(queries, targets, max_bits, ratio)
    assert len(expected) > 20
    assert found(queries, targets, max_bits, ratio) == expected


def test_queries_far_outside_find_nothing_and_do_no_harm() -> None:
    targets, queries = targets_and_queries(0, q=6)
    far = np.array([[-1e6, 0], [1e6, 60], [80, -1e6], [80, 1e6], [1e30, 1e30], [-1e30, 3]], np.float32)
    assert found(replace(queries, px=far), targets, max_bits=256) == {}


def test_a_window_larger_than_the_image_sees_all_of_it() -> None:
    targets, queries = targets_and_queries(1, q=50)
    queries = replace(queries, radius_px=np.full(50, 1e4, np.float32))
    assert found(queries, targets) == search_windows_plainly(queries, targets, 100, 1.0)


def test_empty_inputs_give_no_matches() -> None:
    targets, queries = targets_and_queries(0, n=5, q=3)
    no_targets = Targets(
        targets.px[:0], targets.octave[:0], targets.right_px[:0], targets.descriptors[:0], targets.usable[:0]
    )
    no_queries = Queries(*(getattr(queries, name)[:0] for name in queries.__dataclass_fields__ if name != "row"))
    assert found(queries, no_targets) == {}
    assert found(no_queries, targets) == {}
    assert found(queries, replace(targets, usable=np.zeros(5, bool))) == {}


def one_pair(**changes: object) -> dict[int, int]:
    """A query right on the only target, changed in one respect."""
    targets = Targets(
        np.array([[50, 40]], np.float32),
        np.array([2], np.int32),
        np.array([30], np.float32),
        np.zeros((1, 32), np.uint8),
        np.array([True]),
    )
    values: dict[str, object] = {
        "px": [[50, 40]],
        "radius_px": [5],
        "min_octave": [1],
        "max_octave": [2],
        "right_px": [30],
    }
    values.update(changes)
    descriptors = np.zeros((1, 32), np.uint8)
    descriptors[0, : int(values.pop("bytes_off", 0))] = 255
    arrays = [np.array(values[name], np.int32 if "octave" in name else np.float32) for name in list(values)]
    return found(Queries(*arrays, descriptors), targets)


@pytest.mark.parametrize(
    ("changes", "is_found"),
    [
        ({}, True),
        ({"px": [[55, 40]]}, True),
        ({"px": [[55.1, 40]]}, False),
        ({"px": [[50, 34.9]]}, False),
        ({"min_octave": [3], "max_octave": [4]}, False),
        ({"min_octave": [0], "max_octave": [1]}, False),
        ({"right_px": [36]}, False),
        ({"right_px": [25]}, True),
        ({"right_px": [-1]}, True),
        ({"bytes_off": 12}, True),
        ({"bytes_off": 13}, False),
    ],
)
def test_each_condition_by_itself(changes: dict[str, object], is_found: bool) -> None:
    assert bool(one_pair(**changes)) == is_found
