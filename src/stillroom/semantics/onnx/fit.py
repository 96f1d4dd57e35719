"""How an image is fitted into a detector's input, and how boxes are mapped back to the image."""

from dataclasses import dataclass

import cv2
import numpy as np

from stillroom.geometry.arrays import F32, F64, U8

LETTERBOX, STRETCH = "letterbox", "stretch"
FITS = (LETTERBOX, STRETCH)
BORDER_GRAY = 114.0
"""Brightness around a letterboxed image: what YOLO v5 to v11 are trained with."""


@dataclass(frozen=True)
class Colors:
    """What a network's numbers mean: (colour − mean) / std, of colours in 0–255 in the order red, green, blue.

    Attributes:
        mean, std: By colour.
        bgr: Whether the channels are in the order blue, green, red.
    """

    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    std: tuple[float, float, float] = (1.0, 1.0, 1.0)
    bgr: bool = False

    @property
    def are_raw(self) -> bool:
        """Whether colours are used unchanged."""
        return not any(self.mean) and set(self.std) == {1.0}


@dataclass(frozen=True)
class Fit:
    """Where an image lies in a network's input.

    Attributes:
        image_px: Width and height of the image.
        input_px: Width and height of the input.
        content_px: Width and height to which the image is resized.
        corner_px: Column and row of the input at which it begins.
    """

    image_px: tuple[int, int]
    input_px: tuple[int, int]
    content_px: tuple[int, int]
    corner_px: tuple[int, int]

    @staticmethod
    def of(image_px: tuple[int, int], input_px: tuple[int, int], how: str) -> "Fit":
        """Return the fit of an image: stretched to the input, or in its middle with its proportions kept."""
        if how == STRETCH:
            return Fit(image_px, input_px, input_px, (0, 0))
        gain = min(input_px[0] / image_px[0], input_px[1] / image_px[1])
        width, height = (max(round(side * gain), 1) for side in image_px)
        return Fit(image_px, input_px, (width, height), ((input_px[0] - width) // 2, (input_px[1] - height) // 2))

    def fill(self, planes: F32, rgb: U8, colors: Colors) -> None:
        """Put an image (H, W, 3) uint8 into the planes of an input (3, rows, columns) float32."""
        content = cv2.resize(rgb, self.content_px, interpolation=cv2.INTER_LINEAR)
        (x, y), (columns, rows) = self.corner_px, self.content_px
        turn = -1 if colors.bgr else 1
        told = zip(cv2.split(content), colors.mean, colors.std, strict=True)
        for plane, (color, mean, std) in zip(planes[::turn], told, strict=True):
            if self.content_px != self.input_px:
                plane.fill((BORDER_GRAY - mean) / std)
            window = plane[y : y + rows, x : x + columns]
            if colors.are_raw:
                window[...] = color
                continue
            np.subtract(color, np.float32(mean), out=window)
            window /= np.float32(std)

    def to_image_px(self, unit: F64) -> F64:
        """Move boxes (N, 4) from the input, its sides of length 1, to the image's pixels.

        Pixel centres are at integers; boxes are cut to the image.
        """
        image, whole = np.array(self.image_px, dtype=np.float64), np.array(self.input_px, dtype=np.float64)
        content = np.array(self.content_px, dtype=np.float64)
        span, shift = image * (whole / content), np.array(self.corner_px) * (image / content) + 0.5
        size = np.tile(image, 2)
        return np.clip(unit * np.tile(span, 2) - np.tile(shift, 2), 0.0, size - 1.0)
