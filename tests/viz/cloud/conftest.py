"""A room to look at: floor, two walls, a ceiling, a crate, and a camera that stands in it."""

import numpy as np
import pytest
from dense_clouds import CEILING, CRATE, FLOOR, WALL, assemble, cube, sheet

from stillroom.data.dense_cloud import DenseCloud


@pytest.fixture(scope="session")
def room() -> DenseCloud:
    """4 m wide (x), 2.5 m high (y points down, floor at 1.2), 4 m deep (z), open behind the camera at z = 0."""
    return assemble(
        [
            sheet((-2, 1.2, 0), (4, 0, 0), (0, 0, 4), (0, -1, 0), FLOOR),
            sheet((-2, -1.3, 4), (4, 0, 0), (0, 2.5, 0), (0, 0, -1), WALL),
            sheet((-2, -1.3, 0), (0, 0, 4), (0, 2.5, 0), (1, 0, 0), WALL),
            sheet((-2, -1.3, 0), (4, 0, 0), (0, 0, 4), (0, 1, 0), CEILING),
            *cube((0.5, 0.9, 2.5), 0.6, CRATE),
        ]
    )


@pytest.fixture(scope="session")
def poses() -> np.ndarray:
    """Twenty poses near the origin, looking along z, rolled and pitched by a few degrees this way and that."""
    from stillroom.geometry import se3

    rng = np.random.default_rng(1)
    turns = [se3.exp(np.concatenate((rng.normal(0, 0.1, 3), rng.normal(0, 0.05, 3)))) for _ in range(20)]
    return np.array(turns)
