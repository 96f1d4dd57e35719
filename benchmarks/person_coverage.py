"""Print what share of the person pixels YOLO-Fastest's boxes cover, and what a frame of it costs.

A second network's person masks (DeepLabv3, VOC class 15) stand for the truth, which no real sequence brings.

    python benchmarks/person_coverage.py "$STILLROOM_DATA"/rgbd_bonn_crowd_first560 \
        "$STILLROOM_MODELS"/deeplabv3_mobilenetv2_voc.onnx --frames 200:560
"""

import argparse
import time
from collections.abc import Callable

import cv2
import numpy as np
import onnxruntime

from stillroom.data.image import Image
from stillroom.datasets.open import open_dataset
from stillroom.protocols import Segmenter
from stillroom.semantics.carried_boxes import CarryConfig
from stillroom.semantics.detector import withhold
from stillroom.semantics.yolo_fastest import YoloFastestConfig

PERSON = 15
WARM_UP_FRAMES = 50
LARGE_PX = 8000


def teacher(model: str) -> Callable[[Image], np.ndarray]:
    """Return a function that gives the person mask (H, W) of an image."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])

    def person(image: Image) -> np.ndarray:
        height, width = (side // 16 * 16 + 1 for side in (image.height, image.width))
        pixels = cv2.resize(image.rgb, (width, height)).astype(np.float32) / 127.5 - 1.0
        logits = session.run(None, {"image": pixels.transpose(2, 0, 1)[None]})[0][0]
        label = logits.argmax(axis=0).astype(np.uint8)
        return cv2.resize(label, (image.width, image.height), interpolation=cv2.INTER_NEAREST) == PERSON

    return person


def segmenters(variant: str, off: list[tuple[int, int]]) -> dict[str, Segmenter]:
    """The ways of carrying boxes on that are compared."""
    ways = {
        "each frame alone": CarryConfig(enabled=False),
        "weak boxes continue": CarryConfig(max_carried=0, enter_confidence=1.0),
        "missed boxes carried": CarryConfig(continue_confidence=1.0, enter_confidence=1.0),
        "both": CarryConfig(enter_confidence=1.0),
        "both, and entering (default)": CarryConfig(),
        "the default, 15 frames": CarryConfig(max_carried=15),
        "the default, grown by 0.05": CarryConfig(grow=0.05),
    }
    return {name: withhold(YoloFastestConfig(variant, carry=way).build(), off) for name, way in ways.items()}


class Tally:
    """What one segmenter covered, and what it cost."""

    def __init__(self) -> None:
        self.covered = self.person = self.extra = self.pixels = self.large = self.carried = 0
        self.cost_s: list[float] = []

    def ask(self, segmenter: Segmenter, image: Image, mask: np.ndarray | None) -> None:
        start_s = time.thread_time()
        answer = segmenter(image)
        cost_s = time.thread_time() - start_s
        if mask is None:
            return
        self.cost_s.append(cost_s)
        missed = np.count_nonzero(mask & ~answer.movable)
        self.covered += np.count_nonzero(mask) - missed
        self.person += np.count_nonzero(mask)
        self.extra += np.count_nonzero(answer.movable & ~mask)
        self.pixels += mask.size
        self.large += missed > LARGE_PX
        self.carried += any(box.carried for box in answer.boxes)

    def line(self, unit_s: float) -> str:
        mean_s = float(np.mean(self.cost_s))
        return (
            f"{100 * self.covered / max(self.person, 1):6.2f} {100 * self.extra / self.pixels:6.2f} {self.large:6d} "
            f"{self.carried:6d}   {1e3 * mean_s:6.2f} {mean_s / unit_s:6.2f}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sequence")
    parser.add_argument("teacher")
    parser.add_argument("--frames", default="200:560")
    parser.add_argument("--detector-off", default="", help="count only these frames, without the detector")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    first, end = (int(word) for word in arguments.frames.split(":"))
    off = [tuple(int(word) for word in arguments.detector_off.split(":"))] if arguments.detector_off else []
    dataset, person, orb = open_dataset(arguments.sequence), teacher(arguments.teacher), cv2.ORB_create(1000)
    asked = {(v, name): s for v in ("1.1", "1.1-xl") for name, s in segmenters(v, off).items()}
    tallies = {key: Tally() for key in asked}
    unit_s = []
    for index in range(max(0, first - WARM_UP_FRAMES), end):
        image = dataset.load(index)
        counts = index >= first and (not off or off[0][0] <= index < off[0][1])
        mask = person(image) if counts else None
        start_s = time.thread_time()
        orb.detectAndCompute(image.gray, None)
        unit_s.append(time.thread_time() - start_s)
        for key, segmenter in asked.items():
            tallies[key].ask(segmenter, image, mask)
    print(f"one unit: {1e3 * np.mean(unit_s):.2f} ms")
    print("covered: share of person pixels in a box, %; extra: share of the image in a box but no person, %;")
    print(f"missed: frames with more than {LARGE_PX} person pixels outside; carried: frames with a carried box")
    print(f"{'':38s} covered  extra missed carried      ms  units")
    for (variant, name), tally in tallies.items():
        print(f"{variant:7s} {name:30s} {tally.line(float(np.mean(unit_s)))}")


if __name__ == "__main__":
    main()
