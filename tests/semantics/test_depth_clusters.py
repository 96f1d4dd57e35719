"""Clusters of whole images: figures against the renderer's masks, hand-marked people in real frames, bad input."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from building import parts

from stillroom.data.clusters import PLANE, UNKNOWN, Clusters
from stillroom.data.image import RgbdImage
from stillroom.data.semantics import Box, Semantics, nothing
from stillroom.datasets.open import open_dataset
from stillroom.errors import ConfigError
from stillroom.geometry.arrays import Bool
from stillroom.geometry.camera import Camera
from stillroom.geometry.cloud.cloud_segments import SegmentLimits
from stillroom.geometry.cloud.planes import PlaneLimits
from stillroom.presets.registry import configure
from stillroom.schedule import Done
from stillroom.semantics.depth_clusters import DepthClusterer, DepthClustersConfig, NoClustersConfig
from stillroom_scenes.config import open_synthetic

CAMERA = Camera(640, 480, 540.0, 540.0, 320.0, 240.0)


def image_of(depth_m: np.ndarray) -> RgbdImage:
    return RgbdImage(0.0, np.zeros((*depth_m.shape, 3), np.uint8), depth_m.astype(np.float32), 0)


def clusters_of(clusterer: DepthClusterer, image: RgbdImage, boxes: tuple[Box, ...] = ()) -> Clusters:
    known = replace(nothing(image.height, image.width), boxes=boxes)
    clusters = clusterer(image, Done(known)).clusters
    assert clusters is not None
    return clusters


def person_box(x0: float, y0: float, x1: float, y1: float) -> Box:
    return Box(x0, y0, x1, y1, "person", 0.9)


def iou(first: Bool, second: Bool) -> float:
    return float((first & second).sum() / max((first | second).sum(), 1))


def check_consistent(clusters: Clusters, n_boxes: int) -> None:
    """What the noun promises."""
    k = len(clusters)
    assert clusters.labels.dtype == np.int16
    assert clusters.labels.min(initial=UNKNOWN) >= PLANE
    assert clusters.labels.max(initial=UNKNOWN) < k
    assert (np.diff(clusters.n_points) <= 0).all()
    for corner in (clusters.centroid_m, clusters.lower_m, clusters.upper_m):
        assert corner.shape == (k, 3)
        assert np.isfinite(corner).all()
    assert (clusters.lower_m <= clusters.centroid_m + 1e-5).all()
    assert (clusters.centroid_m <= clusters.upper_m + 1e-5).all()
    assert clusters.box.shape == (k,)
    assert ((clusters.box >= -1) & (clusters.box < n_boxes)).all()
    assert clusters.planes.shape[1] == 4
    np.testing.assert_allclose(np.linalg.norm(clusters.planes[:, :3], axis=1), 1.0, atol=1e-5)
    assert (clusters.planes[:, 3] > 0).all()  # normals towards the camera


# --- figures in rendered rooms ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("spec", "frames", "mean_iou"),
    [
        ("synthetic:walking", range(60, 270, 15), 0.95),
        ("synthetic:carried,frames=330", range(90, 330, 24), 0.95),
        ("synthetic:pushed,frames=330", range(60, 180, 15), 0.85),
    ],
)
def test_clusters_of_true_boxes_cover_the_figures(spec: str, frames: range, mean_iou: float) -> None:
    room = open_synthetic(spec)
    clusterer = DepthClustersConfig().build(parts(room.camera, seed=0))
    scores, n_plane, n_truth = [], 0, 0
    for index in frames:
        image = room.load(index)
        truth = image.truth
        assert truth is not None
        assert truth.mask is not None
        figures = truth.mask & (image.depth_m > 0)
        if figures.sum() < 3000:
            continue
        clusters = clusters_of(clusterer, image, truth.boxes)
        check_consistent(clusters, len(truth.boxes))
        covering = np.isin(clusters.labels, np.flatnonzero(clusters.box >= 0))
        scores.append(iou(covering, figures))
        n_plane += int((figures & (clusters.labels == PLANE)).sum())
        n_truth += int(figures.sum())
    assert len(scores) >= 6
    assert np.mean(scores) > mean_iou
    assert n_plane < 0.005 * n_truth


@pytest.mark.parametrize("figures", ["walking", "carried"])
def test_without_boxes_figures_are_cut_up_but_never_fused(figures: str) -> None:
    room = open_synthetic(f"synthetic:{figures}")
    clusterer = DepthClustersConfig().build(parts(room.camera, seed=0))
    scores = []
    for index in range(60, 270, 20):
        image = room.load(index)
        assert image.truth is not None
        assert image.truth.mask is not None
        truth = image.truth.mask & (image.depth_m > 0)
        if truth.sum() < 3000:
            continue
        clusters = clusters_of(clusterer, image)
        labelled = clusters.labels >= 0
        inside = np.bincount(clusters.labels[labelled & truth], minlength=len(clusters))
        outside = np.bincount(clusters.labels[labelled & ~truth], minlength=len(clusters))
        fused = np.minimum(inside, outside).sum() / truth.sum()
        assert fused < 0.01, f"frame {index}: clusters that are neither figure nor room"
        scores.append(iou(np.isin(clusters.labels, np.flatnonzero(inside > outside)), truth))
    assert np.mean(scores) > 0.93
    assert min(scores) > 0.8


def test_empty_rooms_have_no_cluster_with_a_box() -> None:
    room = open_synthetic("synthetic:empty")
    clusters = clusters_of(DepthClustersConfig().build(parts(room.camera, seed=0)), room.load(40))
    assert len(clusters) > 3  # furniture
    assert (clusters.box == -1).all()
    assert (clusters.labels == PLANE).mean() > 0.4


# --- a person at a table (the paper's Figure 7) ----------------------------------------------------------------------


def at_a_table(noise_seed: int) -> tuple[RgbdImage, Bool, Bool, Box]:
    """A round figure whose hip touches a narrow table, before a wall; return figure, table and the figure's box."""
    u, v = np.meshgrid((np.arange(640) - 320.0) / 540.0, (np.arange(480) - 240.0) / 540.0)
    wall = np.full((480, 640), 3.6)
    x0, z0, radius = -0.2, 2.2, 0.18
    a, b = u * u + 1.0, u * x0 + z0
    root = b * b - a * (x0 * x0 + z0 * z0 - radius * radius)
    figure_m = np.where((root > 0) & (v > -0.35) & (v < 0.38), (b - np.sqrt(np.maximum(root, 0))) / a, 9.0)
    table_m = np.where((u > -0.02) & (u < 0.42) & (v > 0.02) & (v < 0.18), 2.12 + 0.15 * u, 9.0)
    table_m = np.where((u > -0.13) & (u < 0.0) & (v > 0.02) & (v < 0.18), 2.12, table_m)
    depth = np.minimum(np.minimum(wall, figure_m), table_m)
    figure, table = depth == figure_m, depth == table_m
    depth += np.random.default_rng(noise_seed).normal(size=depth.shape) * 0.0012 * depth**2
    rows, columns = np.nonzero(figure)
    box = person_box(columns.min() - 3, rows.min() - 3, columns.max() + 3, rows.max() + 3)
    return image_of(depth), figure, table, box


@pytest.mark.parametrize("noise_seed", [0, 1])
def test_with_his_box_a_person_does_not_fuse_with_the_table_he_leans_on(noise_seed: int) -> None:
    image, figure, table, box = at_a_table(noise_seed)
    clusterer = DepthClustersConfig().build(parts(CAMERA, seed=0))
    plain = clusters_of(clusterer, image)
    both = plain.labels[np.nonzero(figure)[0][::50], np.nonzero(figure)[1][::50]]
    fused = np.bincount(both[both >= 0]).argmax()
    assert (plain.labels[table] == fused).mean() > 0.5, "the scene is too easy: they do not touch"

    clusters = clusters_of(clusterer, image, (box,))
    person = np.isin(clusters.labels, np.flatnonzero(clusters.box == 0))
    assert iou(person, figure) > 0.9
    beyond = table.copy()
    beyond[:, : int(box.x_max_px) + 1 + 4] = False  # a sample speaks for the pixels around it
    assert beyond.sum() > 10000
    assert not person[beyond].any()
    table_label = np.bincount(clusters.labels[beyond & (clusters.labels >= 0)]).argmax()
    assert clusters.box[table_label] == -1
    assert (clusters.labels[beyond] == table_label).mean() > 0.9


def test_a_hand_beyond_the_box_is_given_back() -> None:
    depth = np.full((480, 640), 3.6)
    depth[100:400, 250:350] = 2.0
    depth[200:230, 350:375] = 2.0  # the hand
    box = person_box(245, 95, 352, 405)
    clusters = clusters_of(DepthClustersConfig().build(parts(CAMERA, seed=0)), image_of(depth), (box,))
    assert len(clusters) == 1
    assert clusters.box.tolist() == [0]
    assert iou(clusters.labels == 0, depth == 2.0) > 0.98


def test_of_two_people_behind_each_other_each_has_his_box() -> None:
    depth = np.full((480, 640), 4.5)
    depth[100:460, 300:420] = 2.9
    depth[60:480, 230:350] = 1.8
    behind, before = person_box(298, 98, 422, 462), person_box(228, 58, 352, 479)
    for boxes, (far, near) in (((behind, before), (0, 1)), ((before, behind), (1, 0))):
        clusters = clusters_of(DepthClustersConfig().build(parts(CAMERA, seed=0)), image_of(depth), boxes)
        assert set(clusters.box[clusters.labels[depth == 1.8]]) == {near}
        assert set(clusters.box[clusters.labels[300, 360:415]]) == {far}


# --- real frames ------------------------------------------------------------------------------------------------------

# Pixels (x, y) marked by hand in the colour images: one row of each person, and one of wall and floor.
MARKED = {
    260: ([[(128, 186), (186, 343)], [(304, 108), (359, 362)]], [(569, 78), (491, 421)]),
    300: ([[(304, 215), (304, 382)], [(491, 196), (512, 392)]], [(118, 78), (196, 450)]),
    340: ([[(177, 187), (150, 363)], [(595, 196), (590, 333)]], [(393, 118), (451, 442)]),
    380: ([[(225, 180), (210, 330)]], [(450, 100), (300, 440)]),
    420: ([[(210, 180), (240, 400)], [(320, 140), (330, 240)], [(560, 180), (500, 400)]], [(420, 120), (420, 420)]),
    460: ([[(100, 180), (120, 350)], [(530, 180), (540, 350)]], [(300, 100), (330, 420)]),
    520: ([[(340, 130), (340, 300)], [(560, 200), (560, 400)]], [(230, 120), (230, 400)]),
    540: ([[(230, 130), (195, 370)], [(540, 200), (530, 360)]], [(350, 100), (330, 440)]),
}


@pytest.mark.parametrize("frame", MARKED)
def test_people_in_real_frames_are_clusters_of_their_own(bonn: Path, frame: int) -> None:
    sequence = open_dataset(str(bonn))
    clusters = clusters_of(DepthClustersConfig().build(parts(sequence.camera, seed=0)), sequence.load(frame))
    check_consistent(clusters, 0)
    people, still = MARKED[frame]
    labels = [set(clusters.labels_at(np.array(person, dtype=np.float64)).tolist()) for person in people]
    assert all(len(own) == 1 and min(own) >= 0 for own in labels), "a person is in pieces, or on a plane"
    assert len(set.union(*labels)) == len(people), "two people are one cluster"
    assert (clusters.labels_at(np.array(still, dtype=np.float64)) == PLANE).all()
    for own in labels:
        k = own.pop()
        extent_m = clusters.upper_m[k] - clusters.lower_m[k]
        assert extent_m[0] < 1.2, "wider than a person"
        assert extent_m[1] < 2.1
        assert extent_m[2] < 1.0


def test_boxes_of_the_detector_name_the_people_of_real_frames(bonn: Path) -> None:
    sequence = open_dataset(str(bonn))
    preset = configure("oc-slam")
    detect, clusterer = preset.semantics.build(), preset.clusters.build(parts(sequence.camera, seed=0))
    named = total = 0
    for frame in (300, 340, 380, 460, 520, 540):
        for index in range(frame - 6, frame + 1):  # boxes are carried over the frames that the detector misses
            image = sequence.load(index)
            semantics = detect(image)
        clusters = clusterer(image, Done(semantics)).clusters
        assert clusters is not None
        check_consistent(clusters, len(semantics.boxes))
        people, still = MARKED[frame]
        assert (clusters.labels_at(np.array(still, dtype=np.float64)) == PLANE).all()
        for person in people:
            at = np.array(person, dtype=np.float64)
            covered = [k for k, b in enumerate(semantics.boxes) if _holds(b, at)]
            labels = clusters.labels_at(at)
            assert (labels >= 0).all()
            total += 1
            named += bool(covered) and bool((clusters.box[labels] >= 0).all())
    assert total >= 10
    assert named >= total - 1


def _holds(box: Box, px: np.ndarray) -> bool:
    low, high = (box.x_min_px, box.y_min_px), (box.x_max_px, box.y_max_px)
    return bool(((px >= low) & (px <= high)).all())


# --- bad input --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf, -np.inf, -3.0, 50.0])
def test_images_without_depth_have_no_clusters(value: float) -> None:
    boxes = (person_box(100, 100, 300, 400),)
    clusters = clusters_of(
        DepthClustersConfig().build(parts(CAMERA, seed=0)), image_of(np.full((480, 640), value)), boxes
    )
    assert len(clusters) == 0
    assert (clusters.labels == UNKNOWN).all()
    check_consistent(clusters, 1)


def test_specks_of_bad_depth_change_nothing_around_them() -> None:
    depth = np.full((480, 640), 3.6)
    depth[100:400, 250:350] = 2.0
    spoilt = depth.copy()
    spots = np.random.default_rng(0).random(depth.shape) < 0.05
    spoilt[spots] = np.random.default_rng(1).choice([np.nan, np.inf, -np.inf, -1.0, 0.0], size=int(spots.sum()))
    clusterer = DepthClustersConfig().build(parts(CAMERA, seed=0))
    good, bad = clusters_of(clusterer, image_of(depth)), clusters_of(clusterer, image_of(spoilt))
    assert len(good) == len(bad) == 1
    assert (bad.labels[spots] == UNKNOWN).all()
    assert (bad.labels == good.labels)[~spots].mean() > 0.999


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (7, 5), (23, 19)])
def test_tiny_images_pass(shape: tuple[int, int]) -> None:
    height, width = shape
    camera = Camera(width, height, 20.0, 20.0, width / 2, height / 2)
    clusters = clusters_of(DepthClustersConfig().build(parts(camera, seed=0)), image_of(np.full(shape, 2.0)))
    assert clusters.labels.shape == shape
    check_consistent(clusters, 0)


@pytest.mark.parametrize(
    "box",
    [
        person_box(-500, -500, -400, -400),
        person_box(700, 10, 900, 300),
        person_box(300, 300, 200, 200),
        person_box(10, 10, 10, 10),
        person_box(-1e9, -1e9, 1e9, 1e9),
    ],
)
def test_odd_boxes_pass(box: Box) -> None:
    depth = np.full((480, 640), 3.6)
    depth[100:400, 250:350] = 2.0
    clusters = clusters_of(DepthClustersConfig().build(parts(CAMERA, seed=0)), image_of(depth), (box,))
    check_consistent(clusters, 1)
    assert len(clusters) == 1
    assert iou(clusters.labels == 0, depth == 2.0) > 0.98


def test_the_same_image_gives_the_same_clusters_and_leaves_the_input_alone() -> None:
    image, _, _, box = at_a_table(3)
    before = image.depth_m.copy()
    clusterer = DepthClustersConfig().build(parts(CAMERA, seed=0))
    first, second = clusters_of(clusterer, image, (box,)), clusters_of(clusterer, image, (box,))
    other = clusters_of(DepthClustersConfig().build(parts(CAMERA, seed=7)), image, (box,))
    for again in (second, other):
        np.testing.assert_array_equal(first.labels, again.labels)
        assert first.centroid_m.tobytes() == again.centroid_m.tobytes()
    np.testing.assert_array_equal(image.depth_m, before)


def test_what_was_known_stays_known() -> None:
    known = Semantics(480, 640, (person_box(1, 2, 3, 4),), mask=np.ones((480, 640), np.bool_))
    image = image_of(np.full((480, 640), 2.0))
    told = DepthClustersConfig().build(parts(CAMERA, seed=0))(image, Done(known))
    assert told.boxes is known.boxes
    assert told.mask is known.mask
    assert NoClustersConfig().build(parts(CAMERA, seed=0))(image, Done(known)) is known


@pytest.mark.parametrize(
    ("config", "key"),
    [
        (DepthClustersConfig(stride=0), "stride"),
        (DepthClustersConfig(box_half_depth_m=0.0), "box_half_depth_m"),
        (DepthClustersConfig(min_depth_m=3.0, max_depth_m=2.0), "max_depth_m"),
        (DepthClustersConfig(segments=SegmentLimits(voxel_m=0.0)), "segments.voxel_m"),
        (DepthClustersConfig(segments=SegmentLimits(tolerance_m=float("nan"))), "segments.tolerance_m"),
        (DepthClustersConfig(segments=SegmentLimits(min_points=0)), "segments.min_points"),
        (DepthClustersConfig(planes=PlaneLimits(cell=0)), "planes.cell"),
    ],
)
def test_impossible_values_are_named(config: DepthClustersConfig, key: str) -> None:
    with pytest.raises(ConfigError, match=key):
        config.build(parts(CAMERA, seed=0))


def test_what_a_mask_covers_belongs_to_no_cluster_and_what_is_carried_is_one_of_its_own() -> None:
    """Somebody at 2 m holds a box in front of him; the wall is at 4 m."""
    depth_m = np.full((480, 640), 4.0, dtype=np.float32)
    body, box = np.zeros((480, 640), dtype=bool), np.zeros((480, 640), dtype=bool)
    body[120:, 260:340] = True
    box[220:300, 320:420] = True
    rows, columns = np.indices(depth_m.shape)
    depth_m[body] = (2.0 + 0.0005 * np.abs(columns - 300))[body]
    depth_m[box] = (1.9 + 0.001 * np.abs(columns - 370) + 0.001 * np.abs(rows - 260))[box]
    mask = body & ~box
    known = Semantics(480, 640, (person_box(260, 120, 420, 479),), mask)
    image = image_of(depth_m)
    joined = DepthClustersConfig().build(parts(CAMERA, seed=0))(image, Done(known)).clusters
    apart = configure("pspnet-slam").clusters.build(parts(CAMERA, seed=0))(image, Done(known)).clusters
    assert joined is not None
    assert apart is not None
    carried = joined.labels[260, 400]
    assert carried == joined.labels[400, 300] >= 0, "without, they are one"
    assert (apart.labels[mask] < 0).mean() > 0.95
    assert (apart.labels[box] == apart.labels[260, 400]).mean() > 0.9
    assert apart.labels[260, 400] >= 0
    assert (apart.box == -1).all(), "the box of who is masked is no help"


def test_a_named_thing_is_taken_apart_from_what_it_touches() -> None:
    """A chair before a shelf that it touches."""
    depth_m = np.full((480, 640), 4.0, dtype=np.float32)
    rows, columns = np.indices(depth_m.shape)
    near = (columns > 200) & (columns < 420) & (rows > 200) & (rows < 420)
    depth_m[near] = (1.5 + 0.004 * np.abs(columns - 310) + 0.003 * np.abs(rows - 310))[near]
    chair = Box(200.0, 200.0, 309.0, 420.0, "chair", 0.8)
    whole, named = (replace(nothing(480, 640), named=boxes) for boxes in ((), (chair,)))
    clusterer = DepthClustersConfig(leave_out_masked=True, box_half_depth_m=1.0).build(parts(CAMERA, seed=0))
    one, two = (clusterer(image_of(depth_m), Done(known)).clusters for known in (whole, named))
    assert one is not None
    assert two is not None
    assert one.labels[310, 250] == one.labels[310, 370] >= 0
    left, right = two.labels[310, 250], two.labels[310, 370]
    assert left != right
    assert (two.box[left], two.box[right]) == (0, -1)
