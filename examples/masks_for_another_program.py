"""Write what moves as masks, and images without it, for a program that expects a static scene.

    python examples/masks_for_another_program.py [SEQUENCE]

Makes, in the working folder: `masks/` (255 where something moves), `rgb_static/` (black there) and `depth_static/`
(0 there; 16 bits, millimetres). Another SLAM system, COLMAP, a Gaussian-splatting trainer: most take one of the three.
For the masks alone there is a command: stillroom run SEQUENCE --export-masks masks
"""

import sys
from pathlib import Path

import cv2
import numpy as np

import stillroom as sr

SEQUENCE = "synthetic:walking,frames=40,fps=10"
MARGIN_PX = 5
"""Dilation of the masks: a margin costs little, while leftover pixels of people cost much."""


def main(sequence: str) -> None:
    folders = {name: Path(name) for name in ("masks", "rgb_static", "depth_static")}
    for folder in folders.values():
        folder.mkdir(exist_ok=True)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * MARGIN_PX + 1, 2 * MARGIN_PX + 1))
    dataset = sr.open_dataset(sequence)
    with sr.Slam("oc-slam", camera=dataset.camera) as slam:
        for image in dataset:
            result = slam.process(image)
            moving = cv2.dilate(result.motion.moving.astype(np.uint8), disc).astype(bool)
            rgb, depth_m = image.rgb.copy(), image.depth_m.copy()
            rgb[moving], depth_m[moving] = 0, 0
            name = f"{image.index:06}.png"
            cv2.imwrite(str(folders["masks"] / name), moving.astype(np.uint8) * 255)
            cv2.imwrite(str(folders["rgb_static"] / name), cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
            cv2.imwrite(str(folders["depth_static"] / name), np.rint(depth_m * 1000).astype(np.uint16))
            print(f"{name}: {moving.mean():4.0%} masked")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else SEQUENCE)
