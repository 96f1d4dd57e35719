"""What an image shows at points."""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from stillroom.geometry.arrays import Floats

Value = TypeVar("Value", bound=np.generic)


def values_at(image: NDArray[Value], px: Floats) -> NDArray[Value]:
    """Return an image's (H, W) values at points (N, 2) [px], (N,): that of the nearest pixel, outside of the edge's."""
    height, width = image.shape
    column, row = np.rint(px).astype(np.int64).T
    values: NDArray[Value] = image[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
    return values
