"""Decide what is dynamic with a sieve of your own, and compare it with the method's.

    python examples/own_sieve.py [SEQUENCE]

An object is dynamic when most of its matches are not where the map has their points; docs/add-a-sieve.md explains it.
"""

import sys
from dataclasses import dataclass

import numpy as np

import stillroom as sr
from stillroom.data.motion import Motion
from stillroom.data.question import Question
from stillroom.data.semantics import union_of
from stillroom.geometry import se3
from stillroom.geometry.pixels import values_at
from stillroom.protocols import Parts

SEQUENCE = "synthetic:walking,frames=40,fps=10"


@dataclass(frozen=True)
class DistanceSieveConfig:
    """Settings; each can be changed by `dynamics.KEY=VALUE`."""

    tolerance_m: float = 0.02
    min_matches: int = 5

    def build(self, parts: Parts) -> "DistanceSieve":
        return DistanceSieve(self)


class DistanceSieve:
    def __init__(self, config: DistanceSieveConfig) -> None:
        self.config = config

    def judge(self, question: Question) -> Motion:
        """Return which keypoints (N,) are static, and which pixels (H, W) move."""
        frame, matches = question.frame, question.matches
        points_m = question.world.points.position_m[matches.point_id]
        predicted_m = se3.transform(question.T_cam_world, points_m)
        depth_m = frame.keypoints.depth_m[matches.keypoint]
        seen_m = frame.camera.back_project(frame.keypoints.px[matches.keypoint], depth_m)
        away_m = np.linalg.norm(seen_m - predicted_m, axis=1)
        fails = away_m > self.config.tolerance_m * np.maximum(depth_m, 1.0)
        raw_px = frame.keypoints.raw_px[matches.keypoint]
        moving = []
        for thing in question.known.objects:
            on_it = values_at(thing.mask, raw_px) & (depth_m > 0)
            if on_it.sum() < self.config.min_matches or fails[on_it].mean() > 0.5:
                moving.append(thing)
        pixels = union_of(moving, frame.image.height, frame.image.width)
        return Motion(~values_at(pixels, frame.keypoints.raw_px), pixels)


def main(sequence: str) -> None:
    dataset = sr.open_dataset(sequence)
    # `module:Class`; from an installed package an entry point gives it a name (docs/add-a-sieve.md).
    sieves = {"nothing rejected": "keep-all", "this sieve": f"{__name__}:DistanceSieveConfig", "oc-slam's": "clusters"}
    for name, kind in sieves.items():
        moving = 0
        with sr.Slam("oc-slam", camera=dataset.camera, settings=[f"dynamics.kind={kind}"]) as slam:
            for image in dataset:
                moving += int(slam.process(image).motion.moving.sum())
        share = moving / (len(dataset) * dataset.camera.width * dataset.camera.height)
        said = f"{name:>16}: {share:5.1%} of all pixels move"
        if dataset.groundtruth is not None:
            said += f", ATE RMSE {sr.evaluate(slam.trajectory(), dataset).as_given.ate_se3_m.rmse:.4f} m"
        print(said)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else SEQUENCE)
