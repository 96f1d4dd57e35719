"""Questions to put to a match sieve: good ones as tracking asks them, and odd ones made of a good one."""

import zlib
from collections.abc import Iterator
from dataclasses import fields, replace

import numpy as np

from stillroom.data.frame import Frame, Keypoints
from stillroom.data.map import Map
from stillroom.data.motion import Stage
from stillroom.data.question import Question
from stillroom.data.semantics import Box, nothing
from stillroom.geometry.arrays import Bool
from stillroom.schedule import Done


def at(question: Question, stage: Stage, index: int) -> Question:
    """Return the same question about image `index`, 0.1 s after the one before, at another stage."""
    image = question.frame.image
    later = replace(image, index=index, timestamp_s=image.timestamp_s + 0.1 * (index - image.index))
    return replace(question, stage=stage, frame=replace(question.frame, image=later))


def fingerprints(question: Question) -> dict[str, int]:
    """Return a checksum of each array that the sieve is given, by name."""
    frame, semantics = question.frame, question.known
    arrays = {
        "frame.image.rgb": frame.image.rgb,
        "frame.image.depth_m": frame.image.depth_m,
        "frame.is_static": frame.is_static,
        "semantics.movable": semantics.movable,
        "T_cam_world": question.T_cam_world,
    }
    for name, noun in (
        ("frame.keypoints", frame.keypoints),
        ("matches", question.matches),
        ("semantics.clusters", semantics.clusters),
    ):
        if noun is not None:
            arrays |= {f"{name}.{field.name}": getattr(noun, field.name) for field in fields(noun)}
    for name in ("keyframes", "keypoints", "points"):
        arrays |= {f"world.{name}.{column}": view for column, view in getattr(question.world, name).views.items()}
    return {name: zlib.crc32(np.ascontiguousarray(array).data) for name, array in arrays.items()}


def odd_questions(question: Question) -> Iterator[tuple[str, Question]]:
    """Vary a good question: what it is put about is poor, or missing."""
    frame, matches, semantics = question.frame, question.matches, question.known
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
    yield "a black image", replace(unmatched, frame=black, semantics=Done(nothing(*size)))
    yield "no depth", replace(question, frame=_without_depth(frame))
    yield "nothing that may move", replace(question, semantics=Done(nothing(*size)))
    yield "no boxes", replace(question, semantics=Done(replace(semantics, boxes=())))
    yield "no clusters", replace(question, semantics=Done(replace(semantics, clusters=None)))
    yield "a mask", replace(question, semantics=Done(replace(semantics, mask=semantics.movable)))
    yield "a box around everything", replace(question, semantics=Done(replace(semantics, boxes=(everything,))))
    unknown_px = np.full_like(matches.reference_px, np.nan)
    yield "matches without references", replace(question, matches=replace(matches, reference_px=unknown_px))


def _with_keypoints(frame: Frame, chosen: Bool) -> Frame:
    columns = {field.name: getattr(frame.keypoints, field.name)[chosen] for field in fields(Keypoints)}
    return replace(frame, keypoints=Keypoints(**columns), is_static=frame.is_static[chosen])


def _without_depth(frame: Frame) -> Frame:
    kp = frame.keypoints
    keypoints = replace(kp, depth_m=np.zeros_like(kp.depth_m), right_px=np.full_like(kp.right_px, -1.0))
    return replace(frame, image=replace(frame.image, depth_m=np.zeros_like(frame.image.depth_m)), keypoints=keypoints)
