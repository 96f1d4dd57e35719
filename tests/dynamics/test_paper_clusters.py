"""OC-SLAM 2.5 as printed: of a cluster more than half of whose pairs fail, all goes, and its box too."""

from dataclasses import replace

import numpy as np
import pytest
from building import parts
from flat_wall import in_box
from staged_things import clusters_of
from two_looks import BOX, static_pair

from stillroom.data.clusters import PLANE
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion, Stage
from stillroom.data.semantics import Box, Semantics
from stillroom.dynamics.paper_clusters import PaperClustersConfig, PaperClusterSieve
from stillroom.dynamics.paper_epipolar import PRINTED, PaperEpipolarConfig
from stillroom.testing.sieve_contract import check_sieve

PAIR = static_pair()
BODY = Box(240, 60, 379, 419, "body", 1.0)
"""The pixels of the cluster; they lie within `BOX`, which reaches beyond them on all sides."""
ON_BODY = in_box(PAIR.frame, BODY)
TEN = np.flatnonzero(ON_BODY)[::6][:10]
"""The only keypoints on the cluster that are matched."""
MATCHES = PAIR.matches.keep(np.isin(PAIR.matches.keypoint, np.concatenate((TEN, np.flatnonzero(~PAIR.inside)))))


def scene(boxed: bool) -> Semantics:
    """A cluster, covered by a box or not."""
    labels = np.full((480, 640), PLANE, dtype=np.int16)
    labels[60:420, 240:380] = 0
    return Semantics(480, 640, (BOX,) if boxed else (), clusters=clusters_of(labels, [0 if boxed else -1]))


def ask(
    n_failing: int,
    boxed: bool,
    stage: Stage = Stage.MOTION_MODEL,
    sieve: PaperClusterSieve | None = None,
    matches: Matches = MATCHES,
) -> Motion:
    """Ask with so many of the ten pairs off their lines."""
    sieve = sieve or PaperClustersConfig().build(parts())
    return PAIR.moved(TEN[:n_failing], 6.0).ask(stage, sieve, matches, scene(boxed))


def test_the_scene_is_worth_asking_about() -> None:
    assert len(TEN) == 10
    assert np.count_nonzero(ON_BODY) > 50
    assert np.count_nonzero(PAIR.inside & ~ON_BODY) > 20, "keypoints in the box beside the cluster"


@pytest.mark.parametrize("stage", [Stage.MOTION_MODEL, Stage.REFERENCE_KEYFRAME])
def test_half_of_the_pairs_are_not_enough(stage: Stage) -> None:
    motion = ask(5, boxed=False, stage=stage)
    assert motion.is_static.all(), "outside boxes only clusters are judged"
    assert not motion.moving.any()
    boxed = ask(5, boxed=True, stage=stage)
    np.testing.assert_array_equal(np.flatnonzero(~boxed.is_static), TEN[:5])  # each alone, by 2.2
    assert not boxed.moving.any()


@pytest.mark.parametrize("stage", [Stage.MOTION_MODEL, Stage.REFERENCE_KEYFRAME])
def test_more_than_half_take_the_whole_cluster(stage: Stage) -> None:
    motion = ask(6, boxed=False, stage=stage)
    np.testing.assert_array_equal(~motion.is_static, ON_BODY)
    np.testing.assert_array_equal(motion.moving, scene(False).clusters.labels == 0)


def test_the_prediction_box_goes_with_its_cluster() -> None:
    motion = ask(6, boxed=True)
    np.testing.assert_array_equal(~motion.is_static, PAIR.inside)
    # Of the dense map only the cluster is removed (2.6).
    np.testing.assert_array_equal(motion.moving, scene(True).clusters.labels == 0)


def test_what_the_first_stage_found_holds_at_the_local_map_of_this_image_only() -> None:
    sieve = PaperClustersConfig().build(parts())
    first = ask(6, True, Stage.MOTION_MODEL, sieve)
    second = ask(0, True, Stage.LOCAL_MAP, sieve)
    np.testing.assert_array_equal(second.is_static, first.is_static)
    np.testing.assert_array_equal(second.moving, first.moving)
    image = replace(PAIR.frame.image, index=PAIR.frame.image.index + 1)
    later = replace(PAIR, frame=replace(PAIR.frame, image=image))
    assert later.ask(Stage.LOCAL_MAP, sieve, MATCHES, scene(True)).is_static.all()


def test_it_is_off_while_relocalizing() -> None:
    motion = ask(10, boxed=True, stage=Stage.RELOCALIZATION)
    assert motion.is_static.all()
    assert not motion.moving.any()


def test_without_a_detector_clusters_are_judged_all_the_same() -> None:
    """Section 3.1: where detection fails, the clusters go on rejecting."""
    assert not ask(10, boxed=False).is_static[ON_BODY].any()


def test_a_cluster_without_pairs_stays() -> None:
    others = PAIR.matches.keep(~PAIR.inside[PAIR.matches.keypoint])
    assert ask(10, boxed=False, matches=others).is_static.all()


def test_equation_2_as_printed_lets_every_cluster_stay() -> None:
    sieve = PaperClustersConfig(PaperEpipolarConfig(distance=PRINTED)).build(parts())
    motion = ask(10, boxed=True, sieve=sieve)
    assert motion.is_static.all()
    assert not motion.moving.any()


def test_it_keeps_the_contract() -> None:
    answers = check_sieve(PaperClustersConfig().build)
    assert not all(answer.motion.is_static.all() for answer in answers)
