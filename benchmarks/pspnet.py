"""Print how well PSPNet finds people, how empty it leaves an empty room, and what it costs; draw its masks.

    OMP_NUM_THREADS=1 python benchmarks/pspnet.py --people "$STILLROOM_DATA"/person_masks \
        --bonn "$STILLROOM_DATA"/rgbd_bonn_crowd_first560 \
        --teacher "$STILLROOM_MODELS"/deeplabv3_mobilenetv2_voc.onnx --picture docs/images/pspnet_bonn.jpg

Person IoU is that of the pictures held out of training, every fifth in sorted order. The 50 frames without people are
every fourth of Bonn's first 200. No sequence brings true masks, so a careful reference stands for them on 20 frames
that no training saw: the teacher at three sizes, plain and mirrored, averaged, its borders mended by depth.
A unit is one `cv2.ORB_create(1000).detectAndCompute` on the same frames in the same process, taken in turn.
"""

import argparse
import time
from pathlib import Path

import cv2
import numpy as np

from stillroom.data.image import Image
from stillroom.datasets.open import open_dataset
from stillroom.semantics.masks.mask_segments import HalfImage, MaskSegments
from stillroom.semantics.masks.pspnet import pspnet
from stillroom.semantics.masks.refine import RefineConfig, refined
from stillroom.viz.marks import draw_outline, enlarged, tint
from stillroom_train.pspnet.evaluate import called_person, overlap
from stillroom_train.pspnet.pictures.gather import PERSON, held_out
from stillroom_train.pspnet.pictures.teacher import Teacher

SIZES_PX = (640, 512, 320)
EMPTY = range(0, 200, 4)
SHOWN = range(206, 566, 18)  # training takes 280, 283, …
TEACHER_SIZES_PX = (769, 641, 513)
COLUMNS, SCALE = 5, 0.5
GREEN, RED = (70, 220, 95), (235, 60, 50)
ROUNDS = 3


def reference(teacher: Teacher, image: Image) -> np.ndarray:
    view = HalfImage.of(image)
    rows, columns = view.shape
    likely = cv2.resize(teacher(image.rgb)[..., PERSON].astype(np.float32), (columns, rows))
    mended = refined(MaskSegments((likely >= 0.5).astype(np.uint8), likely), view.depth_m, RefineConfig())
    return mended.mask


def masks_at_half_size(network, image: Image) -> tuple[np.ndarray, np.ndarray]:
    """Return what the network says alone, and mended by depth as in a run."""
    view = HalfImage.of(image)
    rows, columns = view.shape
    likely = network.probabilities(image.rgb, columns, rows)[0]
    alone = MaskSegments((likely >= 0.5).astype(np.uint8), likely)
    return alone.mask, refined(alone, view.depth_m, RefineConfig()).mask


def cost(network, images: list[Image]) -> tuple[float, float]:
    """Return a unit [ms], and the network in units, its input's and output's making included."""
    orb = cv2.ORB_create(1000)
    units, times = [], []
    for _ in range(ROUNDS):
        for image in images:
            begin = time.thread_time()
            orb.detectAndCompute(image.gray, None)
            middle = time.thread_time()
            network.probabilities(image.rgb, image.width // 2, image.height // 2)
            units.append(middle - begin)
            times.append(time.thread_time() - middle)
    return 1e3 * float(np.median(units)), float(np.median(times) / np.median(units))


def drawn(image: Image, true: np.ndarray, told: np.ndarray) -> np.ndarray:
    size = (image.width, image.height)
    true, told = (cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0 for mask in (true, told))
    picture = enlarged(image.rgb, SCALE)
    tint(picture, told & ~true, RED, 0.55)
    tint(picture, true & ~told, GREEN, 0.55)
    draw_outline(picture, told, RED, 2)
    return picture


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--model", type=Path, help="a file of 'stillroom export pspnet'; otherwise the shipped one")
    parser.add_argument("--people", type=Path, required=True)
    parser.add_argument("--bonn", required=True)
    parser.add_argument("--teacher", type=Path)
    parser.add_argument("--cache", type=Path, default=Path.home() / ".cache" / "stillroom" / "teacher")
    parser.add_argument("--picture", type=Path)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)

    bonn = open_dataset(arguments.bonn)
    empty = [bonn.load(place) for place in EMPTY]
    pictures = list(held_out(arguments.people))
    for size in SIZES_PX:
        network = pspnet(arguments.model, [PERSON], size)

        def segment(rgb: np.ndarray, network=network) -> np.ndarray:
            return network.probabilities(rgb, rgb.shape[1], rgb.shape[0])[0] >= 0.5

        found = overlap(segment, pictures)
        share = called_person(segment, (image.rgb for image in empty))
        unit_ms, units = cost(network, empty[:10])
        print(
            f"longer side {size} px: person IoU {found.mean:.3f} mean, {found.total:.3f} total on {found.pictures} "
            f"pictures; {100 * share:.3f} % of an empty room called person; {units:.1f} units a frame of 4:3 "
            f"(unit {unit_ms:.1f} ms)"
        )
    if arguments.teacher is None:
        return
    teacher = Teacher(arguments.teacher, arguments.cache, TEACHER_SIZES_PX)
    network = pspnet(arguments.model, [PERSON], SIZES_PX[0])
    tiles, counts = [], np.zeros((2, 2))
    for image in (bonn.load(place) for place in SHOWN if place < len(bonn)):
        true = reference(teacher, image)
        masks = masks_at_half_size(network, image)
        counts += [[(told & true).sum(), (told | true).sum()] for told in masks]
        tiles.append(drawn(image, true, masks[1]))
    alone, mended = counts[:, 0] / counts[:, 1]
    print(f"{len(tiles)} Bonn frames against the reference: IoU {alone:.3f} alone, {mended:.3f} mended by depth")
    if arguments.picture is not None:
        rows = [np.hstack(tiles[first : first + COLUMNS]) for first in range(0, len(tiles), COLUMNS)]
        cv2.imwrite(str(arguments.picture), np.vstack(rows)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 80])


if __name__ == "__main__":
    main()
