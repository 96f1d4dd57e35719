"""The contract of every `MatchSieve`.

In a test of your own::

    from stillroom.testing.sieve_contract import check_sieve

    def test_my_sieve():
        check_sieve(MySieveConfig().build)  # anything that builds a fresh one of parts
"""

import itertools
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace

import numpy as np

from stillroom.config import SlamConfig
from stillroom.data.frame import Frame, Keypoints
from stillroom.data.image import Image
from stillroom.data.map import Map
from stillroom.data.motion import Motion, Stage
from stillroom.data.question import Question
from stillroom.data.semantics import Box, Semantics, nothing
from stillroom.datasets.open import open_dataset
from stillroom.dynamics.asking import Asking
from stillroom.geometry.arrays import F64, Bool
from stillroom.geometry.camera import Camera
from stillroom.protocols import Dataset, MatchSieve, Parts, RememberingSieve
from stillroom.schedule import Done
from stillroom.system import build as build_system
from stillroom.testing.true_clusters import true_clusters

TINY = "synthetic:walking,frames=20,fps=8,cache=off"
"""Two and a half seconds; figures walk in from both sides."""
SEED = 3
FEWEST_MATCHES = 40
"""Fewest matches of the question from which degenerate ones are made."""
Build = Callable[[Parts], MatchSieve]


# Questions for a match sieve: valid ones as in tracking, and degenerate ones derived from them.


def at(question: Question, stage: Stage, index: int) -> Question:
    """Return the same question about image `index`, 0.1 s after the one before, at another stage."""
    image = question.frame.image
    later = image.at(index, image.timestamp_s + 0.1 * (index - image.index))
    return replace(question, stage=stage, frame=replace(question.frame, image=later))


def fingerprints(question: Question) -> dict[str, int]:
    """Return a checksum of each array of a question, by name."""
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
    """Derive degenerate questions: data is poor, or missing."""
    frame, matches, semantics = question.frame, question.matches, question.known
    none, size = np.zeros(len(matches), dtype=np.bool_), (frame.image.height, frame.image.width)
    one = none.copy()
    one[:1] = True
    everything = Box(0.0, 0.0, size[1] - 1.0, size[0] - 1.0, "person", 1.0)
    empty = _with_keypoints(frame, np.zeros(len(frame), dtype=np.bool_))
    black = _without_depth(replace(empty, image=frame.image.black()))
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
    return replace(frame, image=frame.image.without_depth(), keypoints=keypoints)


@dataclass(frozen=True)
class Answer:
    """A result of a sieve during a run.

    Attributes:
        stage, index: The stage, and the number of the image.
        motion: The result.
    """

    stage: Stage
    index: int
    motion: Motion


def check_sieve(build: Build, dataset: Dataset | None = None) -> list[Answer]:
    """Check that a match sieve fulfils the contract.

    The camera is tracked through a short rendered sequence with the sieve; it gets the renderer's boxes, and its
    figures as clusters. Then degenerate questions are put to it, new and after the run.

    Args:
        build: Returns a new sieve, built of parts.
        dataset: A rendered sequence of some 20 frames; by default the package's own.

    Returns:
        Its results during the run, for further assertions.

    Raises:
        AssertionError: It does not; the message says which rule is broken, and where.
    """
    dataset = dataset or open_dataset(TINY)
    tracking = _Tracking(build)
    system = build_system(SlamConfig(dynamics=tracking), dataset.camera, _TrueBoxesAndClusters(dataset.camera))
    for place in range(len(dataset)):
        system.process(dataset.load(place))
    system.close()
    tracking.check_answers()
    last = tracking.last_question(system.map)
    numbers = itertools.count(last.frame.image.index + 1)
    pasts = {"fresh": tracking.fresh(), "with another seed": tracking.fresh(SEED + 1), "after a run": tracking.sieve}
    for what, question in odd_questions(last):
        for past, sieve in (pasts | {"fresh": tracking.fresh()}).items():
            _check_odd(sieve, question, numbers, f"{what}, {past}")
    return tracking.answers


class _Tracking:
    """Replaces the tracker's sieve: passes each question to the sieve, twice, and to a second instance of it."""

    def __init__(self, build: Build) -> None:
        self.build_one = build
        self.answers: list[Answer] = []
        self.copies: list[Motion] = []
        self.last: Question | None = None

    def build(self, parts: Parts) -> MatchSieve:
        self.parts = replace(parts, seed=SEED)
        self.sieve, self.twin = self.fresh(), self.fresh()
        return self

    def fresh(self, seed: int = SEED) -> Asking:
        return _led(self.build_one(replace(self.parts, seed=seed)), self.parts.world)

    def judge(self, question: Question) -> Motion:
        stage, index = question.stage, question.frame.image.index
        where, motion = _where(question), self.sieve.judge(question)
        _check_same(self.twin.judge(question), motion, f"{where}: another one of the same seed")
        _check_same(self.sieve.judge(question), motion, f"{where}: asked the same once more")
        self.answers.append(Answer(stage, index, motion))
        self.copies.append(Motion(motion.is_static.copy(), motion.moving.copy()))
        if stage is Stage.MOTION_MODEL:
            self.last = question
        return motion

    def remember(self, frame: Frame, T_cam_world: F64, keyframe: int) -> None:
        for asked in (self.sieve, self.twin):
            asked.remember(frame, T_cam_world, keyframe)

    def corrected(self, T_new_old: F64) -> None:
        """Do nothing: the sieve and the second instance have their own life cycle."""

    def check_answers(self) -> None:
        missing = {Stage.MOTION_MODEL, Stage.REFERENCE_KEYFRAME, Stage.LOCAL_MAP} - {a.stage for a in self.answers}
        names = ", ".join(sorted(stage.name for stage in missing))
        assert not missing, f"tracking never came to {names}: what is left does not suffice"
        for answer, copy in zip(self.answers, self.copies, strict=True):
            _check_same(answer.motion, copy, f"image {answer.index}, {answer.stage.name}: later, what was answered")

    def last_question(self, world: Map) -> Question:
        """Return the last question of the motion-model stage, without the points that mapping removed since."""
        assert self.last is not None
        matches = self.last.matches
        matches = matches.keep(world.points.is_alive[matches.point_id])
        assert len(matches) >= FEWEST_MATCHES, f"only {len(matches)} matches in the last image"
        assert self.last.known.boxes, "the last image shows nothing that may move; choose another sequence"
        return replace(self.last, matches=matches)


class _TrueBoxesAndClusters:
    """Returns boxes as a detector would, and clusters as of a depth cloud."""

    def __init__(self, camera: Camera) -> None:
        self.camera = camera

    def __call__(self, image: Image) -> Semantics:
        assert image.truth is not None, f"image {image.index} has no ground truth: the sequence must be a rendered one"
        clusters = true_clusters(image, self.camera)
        return Semantics(image.height, image.width, image.truth.boxes, clusters=clusters)


def _where(question: Question) -> str:
    return f"image {question.frame.image.index}, {question.stage.name}"


def _led(sieve: MatchSieve, world: Map) -> Asking:
    """Return the life cycle of a sieve whose results are checked."""
    return Asking(_Checked(sieve), world)


class _Checked:
    """A proxy of a sieve; checks that it does not modify its input, and that its results are complete."""

    def __init__(self, sieve: MatchSieve) -> None:
        self.sieve = sieve

    def judge(self, question: Question) -> Motion:
        where = _where(question)
        before = fingerprints(question)
        motion = self.sieve.judge(question)
        changed = [name for name, checksum in fingerprints(question).items() if checksum != before[name]]
        assert not changed, f"{where}: the sieve changed what it was given: {', '.join(changed)}"
        assert isinstance(motion, Motion), f"{where}: the answer is a {type(motion).__name__}, not Motion"
        image = question.frame.image
        for name, verdict, shape in (
            ("is_static", motion.is_static, (len(question.frame),)),
            ("moving", motion.moving, (image.height, image.width)),
        ):
            assert isinstance(verdict, np.ndarray), f"{where}: {name} is a {type(verdict).__name__}, not an array"
            assert verdict.dtype == np.bool_, f"{where}: {name} is {verdict.dtype}, not bool"
            assert verdict.shape == shape, f"{where}: {name} is {verdict.shape}, not {shape}; it judges the whole image"
        return motion

    def remember(self, frame: Frame, T_cam_world: F64, keyframe: int) -> None:
        if isinstance(self.sieve, RememberingSieve):
            self.sieve.remember(frame, T_cam_world, keyframe)

    def corrected(self, T_new_old: F64) -> None:
        if isinstance(self.sieve, RememberingSieve):
            self.sieve.corrected(T_new_old)


def _check_same(motion: Motion, expected: Motion, who: str) -> None:
    assert np.array_equal(motion.is_static, expected.is_static), f"{who} says otherwise of the keypoints"
    assert np.array_equal(motion.moving, expected.moving), f"{who} says otherwise of the pixels"


def _check_odd(sieve: Asking, question: Question, numbers: Iterator[int], what: str) -> None:
    for stage in Stage:  # Each with a new image: results of another stage must not be cached.
        try:
            sieve.judge(at(question, stage, next(numbers)))
        except AssertionError as error:
            raise AssertionError(f"{what}: {error}") from error
