"""Questions to put to a match sieve: good ones as tracking asks them, and odd ones made of a good one."""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np

from stillroom.data.frame import Frame, Keypoints
from stillroom.data.map import Map
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion, Stage
from stillroom.data.semantics import Box, Semantics, nothing
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, Bool
from stillroom.protocols import MatchSieve
from stillroom.schedule import Done


@dataclass(frozen=True)
class Question:
    """What a sieve is asked; see `MatchSieve.judge`."""

    stage: Stage
    frame: Frame
    matches: Matches
    semantics: Semantics
    T_cam_world: F64
    world: Map

    def put_to(self, sieve: MatchSieve) -> Motion:
        """Return the sieve's answer."""
        pending = Done(self.semantics)
        return sieve.judge(self.stage, self.frame, self.matches, pending, self.T_cam_world, self.world)

    def at(self, stage: Stage, index: int) -> "Question":
        """Return the same question about image `index`, 0.1 s after the one before, at another stage."""
        image = self.frame.image
        later = replace(image, index=index, timestamp_s=image.timestamp_s + 0.1 * (index - image.index))
        return replace(self, stage=stage, frame=replace(self.frame, image=later))

    def fingerprints(self) -> dict[str, int]:
        """Return a checksum of each array that the sieve is given, by name."""
        frame, semantics = self.frame, self.semantics
        arrays = {
            "frame.image.rgb": frame.image.rgb,
            "frame.image.depth_m": frame.image.depth_m,
            "frame.is_static": frame.is_static,
            "semantics.movable": semantics.movable,
            "T_cam_world": self.T_cam_world,
        }
        for name, noun in (
            ("frame.keypoints", frame.keypoints),
            ("matches", self.matches),
            ("semantics.clusters", semantics.clusters),
        ):
            if noun is not None:
                arrays |= {f"{name}.{field.name}": getattr(noun, field.name) for field in fields(noun)}
        for name in ("keyframes", "keypoints", "points"):
            arrays |= {f"world.{name}.{column}": view for column, view in getattr(self.world, name).views.items()}
        return {name: zlib.crc32(np.ascontiguousarray(array).data) for name, array in arrays.items()}


def odd_questions(question: Question) -> Iterator[tuple[str, Question]]:
    """Vary a good question: what it is put about is poor, or missing."""
    frame, matches, semantics = question.frame, question.matches, question.semantics
    none, size = np.zeros(len(matches), dtype=np.bool_), (frame.image.height, frame.image.width)
    one = none.copy()
    one[:1] = True
    everything = Box(0.0, 0.0, size[1] - 1.0, size[0] - 1.0, "person", 1.0)
    empty, dark = _with_keypoints(frame, np.zeros(len(frame), dtype=np.bool_)), np.zeros_like(frame.image.rgb)
    black = _without_depth(replace(empty, image=replace(frame.image, rgb=dark, truth=None)))
    unmatched = replace(question, matches=matches.keep(none))
    yield "no matches", unmatched
    yield "an empty map", replace(unmatched, world=Map(question.world.scales), T_cam_world=np.eye(4))
    yield "one match", replace(question, matches=matches.keep(one))
    yield "no keypoints", replace(unmatched, frame=empty)
    yield "a black image", replace(unmatched, frame=black, semantics=nothing(*size))
    yield "no depth", replace(question, frame=_without_depth(frame))
    yield "nothing that may move", replace(question, semantics=nothing(*size))
    yield "no boxes", replace(question, semantics=replace(semantics, boxes=()))
    yield "no clusters", replace(question, semantics=replace(semantics, clusters=None))
    yield "a mask", replace(question, semantics=replace(semantics, mask=semantics.movable))
    yield "a box around everything", replace(question, semantics=replace(semantics, boxes=(everything,)))
    unknown_px = np.full_like(matches.reference_px, np.nan)
    yield "matches without references", replace(question, matches=replace(matches, reference_px=unknown_px))


def failing_question(question: Question, outside: int) -> Question:
    """Return the question with all but `outside` matches in one box, and a pose so wrong that they fail any test."""
    frame, size = question.frame, question.frame.image.gray.shape
    x_px = np.sort(frame.keypoints.raw_px[question.matches.keypoint, 0])
    left_px = float(np.ceil(x_px[outside - 1])) + 1.0 if outside else 0.0
    box = Box(left_px, 0.0, size[1] - 1.0, size[0] - 1.0, "person", 1.0)
    wrong = question.T_cam_world @ se3.exp(np.array([0.3, 0.2, 0.0, 0.0, 0.0, 0.0]))
    return replace(question, semantics=replace(question.semantics, boxes=(box,)), T_cam_world=wrong)


def _with_keypoints(frame: Frame, chosen: Bool) -> Frame:
    columns = {field.name: getattr(frame.keypoints, field.name)[chosen] for field in fields(Keypoints)}
    return replace(frame, keypoints=Keypoints(**columns), is_static=frame.is_static[chosen])


def _without_depth(frame: Frame) -> Frame:
    kp = frame.keypoints
    keypoints = replace(kp, depth_m=np.zeros_like(kp.depth_m), right_px=np.full_like(kp.right_px, -1.0))
    return replace(frame, image=replace(frame.image, depth_m=np.zeros_like(frame.image.depth_m)), keypoints=keypoints)
