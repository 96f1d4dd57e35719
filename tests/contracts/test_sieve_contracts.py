"""Every match sieve that can be chosen keeps the socket's contract; and the contract notices when one does not."""

from dataclasses import replace

import numpy as np
import pytest

from stillroom.config.kinds import DYNAMICS
from stillroom.data.frame import Frame
from stillroom.data.map import Map
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion, Stage
from stillroom.data.question import Question
from stillroom.data.semantics import Semantics
from stillroom.datasets.open import open_dataset
from stillroom.datasets.selection import select
from stillroom.dynamics.whole_boxes import WholeBoxes
from stillroom.protocols import Dataset, Parts
from stillroom.testing.sieve_contract import TINY, check_sieve
from stillroom.testing.true_clusters import true_clusters


@pytest.mark.parametrize("kind", DYNAMICS.classes)
def test_keeps_the_contract(kind: str) -> None:
    answers = check_sieve(DYNAMICS.classes[kind]().build)
    rejects = [not answer.motion.is_static.all() for answer in answers]
    # Half of the sequence shows figures that walk; a sieve that never minds them is called keep-all.
    assert any(rejects[-10:]) == (kind != "keep-all")


@pytest.fixture(scope="module")
def short() -> Dataset:
    """A few frames of the contract's own sequence, with two figures in view."""
    return select(open_dataset(TINY), "11:15")


class Fine(WholeBoxes):
    """A sieve that keeps the contract; the classes below break one promise each."""

    def __init__(self, parts: Parts) -> None:
        self.seed = parts.seed

    def judge(self, question: Question) -> Motion:
        q = question
        self.on(q.stage, q.frame, q.matches, q.known, q.T_cam_world, q.world)
        return self.spoil(super().judge(q), q.stage, q.matches)

    def on(
        self, stage: Stage, frame: Frame, matches: Matches, semantics: Semantics, T_cam_world: np.ndarray, world: Map
    ) -> None:
        pass

    def spoil(self, motion: Motion, stage: Stage, matches: Matches) -> Motion:
        return motion


class Sloppy(Fine):
    def spoil(self, motion: Motion, stage: Stage, matches: Matches) -> Motion:
        return motion.is_static


class MatchesOnly(Fine):
    def spoil(self, motion: Motion, stage: Stage, matches: Matches) -> Motion:
        return replace(motion, is_static=motion.is_static[matches.keypoint])


class Bytes(Fine):
    def spoil(self, motion: Motion, stage: Stage, matches: Matches) -> Motion:
        return replace(motion, is_static=motion.is_static.astype(np.uint8))


class Transposed(Fine):
    def spoil(self, motion: Motion, stage: Stage, matches: Matches) -> Motion:
        return replace(motion, moving=motion.moving.T)


class NoPixels(Fine):
    def spoil(self, motion: Motion, stage: Stage, matches: Matches) -> Motion:
        return replace(motion, moving=None)


class Random(Fine):
    rng = np.random.default_rng(0)

    def spoil(self, motion: Motion, stage: Stage, matches: Matches) -> Motion:
        return replace(motion, is_static=motion.is_static & (self.rng.random(len(motion.is_static)) < 0.9))


class Impatient(Fine):
    """Counts evidence by the question, not by the frame."""

    asked = 0

    def spoil(self, motion: Motion, stage: Stage, matches: Matches) -> Motion:
        self.asked += 1
        return replace(motion, is_static=motion.is_static & (np.arange(len(motion.is_static)) != self.asked))


class OneBuffer(Fine):
    """Hands out the same array again and again."""

    def __init__(self, parts: Parts) -> None:
        super().__init__(parts)
        self.moving = np.zeros((480, 640), np.bool_)

    def spoil(self, motion: Motion, stage: Stage, matches: Matches) -> Motion:
        self.moving[:] = motion.moving
        return replace(motion, moving=self.moving)


class Verdicts(Fine):
    def on(self, stage: Stage, frame: Frame, *rest: object) -> None:
        frame.is_static[:3] = ~frame.is_static[:3]


class Filler(Fine):
    def on(self, stage: Stage, frame: Frame, *rest: object) -> None:
        frame.image.depth_m[0, 0] += 1


class Marker(Fine):
    def on(self, stage: Stage, frame: Frame, matches: Matches, *rest: object) -> None:
        matches.point_id[:1] += 1


class Pusher(Fine):
    def on(
        self, stage: Stage, frame: Frame, matches: Matches, semantics: Semantics, T_cam_world: np.ndarray, world: Map
    ) -> None:
        T_cam_world[0, 3] += 1e-9


class Culler(Fine):
    def on(
        self, stage: Stage, frame: Frame, matches: Matches, semantics: Semantics, T_cam_world: np.ndarray, world: Map
    ) -> None:
        world.points.n_found[:1] += 1


class Painter(Fine):
    def on(self, stage: Stage, frame: Frame, matches: Matches, semantics: Semantics, *rest: object) -> None:
        semantics.movable[0] = ~semantics.movable[0]


class Relabeller(Fine):
    def on(self, stage: Stage, frame: Frame, matches: Matches, semantics: Semantics, *rest: object) -> None:
        if semantics.clusters is not None:
            semantics.clusters.labels[0] += 1


class AfraidOfTheDark(Fine):
    def on(self, stage: Stage, frame: Frame, *rest: object) -> None:
        assert len(frame) > 0, "too dark"


class NeedsDepth(Fine):
    def on(self, stage: Stage, frame: Frame, *rest: object) -> None:
        assert len(frame) == 0 or frame.keypoints.depth_m.max() > 0, "too flat"


class NeedsMatches(Fine):
    def on(self, stage: Stage, frame: Frame, matches: Matches, semantics: Semantics, *rest: object) -> None:
        if stage is not Stage.LOCAL_MAP:
            assert np.mean(matches.point_id >= 0) == 1, "no mean of nothing"


class NeedsClusters(Fine):
    def on(self, stage: Stage, frame: Frame, matches: Matches, semantics: Semantics, *rest: object) -> None:
        assert not semantics.boxes or semantics.clusters is not None, "nobody looked"


class NeedsBoxes(Fine):
    def on(self, stage: Stage, frame: Frame, matches: Matches, semantics: Semantics, *rest: object) -> None:
        assert semantics.boxes or semantics.clusters is None or len(semantics.clusters) == 0, "no box"


class SeedOfThree(Fine):
    def on(self, stage: Stage, *rest: object) -> None:
        assert self.seed == 3, "any seed"


class HungOnAPast(Fine):
    """Compares with the keypoints of the image before, whose number may be another."""

    previous: np.ndarray | None = None
    number = -1

    def spoil(self, motion: Motion, stage: Stage, matches: Matches) -> Motion:
        if len(motion.is_static) == 0 and self.previous is not None:
            return replace(motion, is_static=self.previous)
        self.previous = motion.is_static
        return motion


def test_a_plain_sieve_passes(short: Dataset) -> None:
    answers = check_sieve(Fine, short)
    assert [(answer.index, answer.stage) for answer in answers] == [
        (11, Stage.LOCAL_MAP),
        (12, Stage.REFERENCE_KEYFRAME),
        (12, Stage.LOCAL_MAP),
        (13, Stage.MOTION_MODEL),
        (13, Stage.LOCAL_MAP),
        (14, Stage.MOTION_MODEL),
        (14, Stage.LOCAL_MAP),
    ]


@pytest.mark.parametrize(
    ("broken", "said"),
    [
        (Sloppy, "is a ndarray, not Motion"),
        (MatchesOnly, r"is_static is \(0,\), not"),
        (Bytes, "is_static is uint8, not bool"),
        (Transposed, r"moving is \(640, 480\), not \(480, 640\)"),
        (NoPixels, "moving is a NoneType"),
        (Random, "another one of the same seed says otherwise of the keypoints"),
        (Impatient, "asked the same once more says otherwise of the keypoints"),
        (OneBuffer, "later, what was answered says otherwise of the pixels"),
        (Verdicts, r"changed what it was given: frame\.is_static"),
        (Filler, r"changed what it was given: frame\.image\.depth_m"),
        (Marker, r"changed what it was given: matches\.point_id"),
        (Pusher, "changed what it was given: T_cam_world"),
        (Culler, r"changed what it was given: world\.points\.n_found"),
        (Painter, r"changed what it was given: semantics\.movable"),
        (Relabeller, r"changed what it was given: semantics\.clusters\.labels"),
        (AfraidOfTheDark, "too dark"),
        (NeedsDepth, "too flat"),
        (NeedsMatches, "no mean of nothing"),
        (NeedsClusters, "nobody looked"),
        (NeedsBoxes, "no box"),
        (SeedOfThree, "any seed"),
        (HungOnAPast, r"is_static is \([0-9]+,\), not \(0,\)"),
    ],
)
@pytest.mark.filterwarnings("ignore:Mean of empty slice", "ignore:invalid value encountered")
def test_the_contract_notices(broken: type[Fine], said: str, short: Dataset) -> None:
    with pytest.raises(AssertionError, match=said):
        check_sieve(broken, short)


def test_true_clusters_are_the_figures(short: Dataset) -> None:
    image = open_dataset(TINY).load(15)
    clusters = true_clusters(image, short.camera)
    assert clusters is not None
    assert len(clusters) >= 2
    assert np.all(np.diff(clusters.n_points) <= 0), "largest first"
    assert image.truth is not None
    for k in range(len(clusters)):
        pixels = clusters.labels == k
        assert pixels.sum() == clusters.n_points[k]
        assert image.truth.movable[pixels].all()
        assert clusters.lower_m[k, 2] == pytest.approx(image.depth_m[pixels].min())
        assert clusters.upper_m[k, 2] == pytest.approx(image.depth_m[pixels].max())
        x0, y0, x1, y1 = image.truth.boxes[clusters.box[k]].xyxy_px
        rows, columns = np.nonzero(pixels)
        assert x0 <= columns.mean() <= x1
        assert y0 <= rows.mean() <= y1
    assert true_clusters(replace(image, truth=None), short.camera) is None


def test_the_contract_wants_a_rendered_sequence(short: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    honest = short.load
    monkeypatch.setattr(short, "load", lambda index: replace(honest(index), truth=None))
    with pytest.raises(AssertionError, match="must be a rendered one"):
        check_sieve(Fine, short)
