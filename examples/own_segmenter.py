"""Find what is potentially dynamic with a function of your own, instead of a method's network.

    python examples/own_segmenter.py [SEQUENCE]

Here: whatever is nearer than two metres is potentially dynamic. Any function from an image to
`Semantics` will do: call your own detector in it.
"""

import sys

import cv2
import numpy as np

import stillroom as sr
from stillroom.data.semantics import Semantics, connected_parts

SEQUENCE = "synthetic:walking,frames=40,fps=10"


class NearThings:
    """Objects nearer than a distance. It is called once for each image, in order, so it may keep state."""

    def __init__(self, nearer_m: float, min_area_px: int) -> None:
        self.nearer_m, self.min_area_px = nearer_m, min_area_px

    def __call__(self, image: sr.Image) -> Semantics:
        near = (image.depth_m > 0) & (image.depth_m < self.nearer_m)
        closed = cv2.morphologyEx(near.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8)).astype(bool)
        things = tuple(part for part in connected_parts(closed, "near thing") if part.area_px >= self.min_area_px)
        return Semantics(image.height, image.width, instances=things)


def main(sequence: str) -> None:
    dataset = sr.open_dataset(sequence)
    segmenter = NearThings(nearer_m=2.0, min_area_px=1500)
    # Potentially dynamic is only a prior: the sieve of oc-slam decides what is dynamic.
    with sr.Slam("oc-slam", camera=dataset.camera, segmenter=segmenter) as slam:
        for image in dataset:
            result = slam.process(image)
            static = result.motion.is_static
            print(f"{result.index:4}: {result.state.value}, {static.sum()} of {len(static)} keypoints are static")
    if dataset.groundtruth is not None:
        rmse_m = sr.evaluate(slam.trajectory(), dataset).as_given.ate_se3_m.rmse
        print(f"ATE RMSE {rmse_m:.4f} m over {len(slam.trajectory())} poses")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else SEQUENCE)
