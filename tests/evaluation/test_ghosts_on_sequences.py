"""Ghosts and completeness of simple maps: back-projected images, with the people in them and without."""

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from stillroom.datasets.bonn import open_bonn
from stillroom.evaluation.ghost_truth import TrueScene, ghosts_by_truth
from stillroom.evaluation.ghost_views import DepthView
from stillroom.evaluation.ghosts import Gatherer, completeness, empty_room, ghosts_in_free_space, seen_again
from stillroom.geometry.arrays import F64, Bool
from stillroom.semantics.yolo_fastest import YoloFastestConfig
from stillroom_scenes.config import open_synthetic
from stillroom_scenes.room import FrameTruth, SyntheticRoom

EVERY = 15


@lru_cache(maxsize=60)
def truth_of(room: SyntheticRoom, index: int) -> FrameTruth:
    return room.truth(index)


@lru_cache(maxsize=2)
def rendered(figures: str) -> tuple[SyntheticRoom, TrueScene]:
    room = open_synthetic(f"synthetic:{figures}")
    remains, static, movers = room.remains(), Gatherer(room.camera), Gatherer(room.camera)
    for index in range(0, len(room), EVERY):
        truth = truth_of(room, index)
        stays = remains.stays(truth.instance, float(room.timestamps_s[index]))
        static.add(truth.depth_m, truth.T_world_cam, stays, reach_m=4.0)
        movers.add(truth.depth_m, truth.T_world_cam, ~stays)
    return room, TrueScene(remains.patches_m, remains.is_triangle, static.points(), movers.points())


def fused(figures: str, keep: Callable[[SyntheticRoom, int], Bool | None]) -> F64:
    room, _ = rendered(figures)
    gatherer = Gatherer(room.camera)
    for index in range(0, len(room), EVERY):
        gatherer.add(room.load(index).depth_m, room.pose(index), keep(room, index), reach_m=4.0)
    return gatherer.points(seen_by=2)


def everything(room: SyntheticRoom, index: int) -> None:
    return None


def what_stays(room: SyntheticRoom, index: int) -> Bool:
    return room.remains().stays(truth_of(room, index).instance, float(room.timestamps_s[index]))


def what_does_not_move_now(room: SyntheticRoom, index: int) -> Bool:
    return ~truth_of(room, index).moving


@pytest.mark.parametrize("figures", ["walking", "pushed"])
def test_a_map_of_what_stays_is_clean_and_complete_and_one_of_everything_is_not(figures: str) -> None:
    _, scene = rendered(figures)
    clean, raw = fused(figures, what_stays), fused(figures, everything)
    ghosts, surface = ghosts_by_truth(clean, scene)
    assert ghosts.share < 0.005
    assert surface.error_m is not None
    assert surface.error_m.median < 0.01
    assert completeness(clean, scene.seen_m).share > 0.97
    with_people, _ = ghosts_by_truth(raw, scene)
    assert with_people.share > max(0.05, 10 * ghosts.share)
    assert completeness(raw, scene.seen_m).share > 0.97


def test_a_chair_that_is_mapped_where_it_was_is_a_ghost() -> None:
    room, scene = rendered("pushed")
    (chair,) = room.scene.objects
    both = fused("pushed", what_does_not_move_now)
    ghosts, _ = ghosts_by_truth(both, scene)
    before_m, after_m = chair.place(0.0)[:2, 3], chair.place(1e4)[:2, 3]
    ghost_points = both[ghosts.is_ghost]
    assert len(ghost_points) > 200
    near_before = np.linalg.norm(ghost_points[:, :2] - before_m, axis=1) < 0.45
    assert near_before.mean() > 0.9
    near_after = (np.linalg.norm(both[:, :2] - after_m, axis=1) < 0.2) & (both[:, 2] > 0.1)
    assert near_after.sum() > 40
    assert not ghosts.is_ghost[near_after].any()


def test_a_wall_that_is_missing_lowers_completeness_by_its_share() -> None:
    _, scene = rendered("walking")
    clean = fused("walking", what_stays)
    north_m = scene.seen_m[:, 1].max()
    in_wall = scene.seen_m[:, 1] > north_m - 0.05
    assert in_wall.mean() > 0.1
    without = completeness(clean[clean[:, 1] < north_m - 0.15], scene.seen_m)
    # Its edges are still found by what borders on it.
    assert without.share == pytest.approx(1 - in_wall.mean(), abs=0.04)
    assert not without.is_found[in_wall].mean() > 0.1


@lru_cache(maxsize=1)
def bonn_views(folder: Path) -> dict[int, DepthView]:
    dataset = open_bonn(folder)
    poses = dataset.groundtruth_at_camera
    assert poses is not None
    views = {}
    for index in range(0, 560, 10):
        nearest = int(np.argmin(np.abs(poses.timestamps_s - dataset.timestamps_s[index])))
        views[index] = DepthView(dataset.load(index).depth_m, poses.T_world_cam[nearest])
    return views


def bonn_map(folder: Path, indices: range, keep: Callable[[int], Bool | None]) -> F64:
    gatherer, views = Gatherer(open_bonn(folder).camera), bonn_views(folder)
    for index in indices:
        gatherer.add(views[index].depth_m, views[index].T_world_cam, keep(index))
    return gatherer.points()


def test_the_empty_room_has_next_to_no_ghosts_in_itself(bonn: Path) -> None:
    camera, views = open_bonn(bonn).camera, bonn_views(bonn)
    later = bonn_map(bonn, range(100, 200, 10), lambda index: None)
    figure = ghosts_in_free_space(later, [views[index] for index in range(0, 100, 10)], camera)
    assert figure.share < 0.01
    # By rays alone much of the room would be a ghost of itself: the sensor is wrong towards the image's corners.
    assert figure.n_suspects > 0.05 * figure.n_points


def test_people_are_ghosts_and_the_room_around_their_boxes_is_none(bonn: Path) -> None:
    dataset, views = open_bonn(bonn), bonn_views(bonn)
    camera, reference = dataset.camera, [views[index] for index in range(0, 200, 10)]
    detector = YoloFastestConfig().build_detector(0.3)
    mapped = range(200, 560, 20)

    def beside_people(index: int) -> Bool:
        free = np.ones((camera.height, camera.width), dtype=np.bool_)
        for box in detector.detect(dataset.load(index)):
            x0, y0, x1, y1 = (int(edge) for edge in box.xyxy_px)
            free[max(0, y0 - 40) : y1 + 40, max(0, x0 - 40) : x1 + 40] = False
        return free

    raw = ghosts_in_free_space(bonn_map(bonn, mapped, lambda index: None), reference, camera)
    masked_map = bonn_map(bonn, mapped, beside_people)
    masked = ghosts_in_free_space(masked_map, reference, camera)
    assert raw.share > 0.2
    # The detector misses some; those are found.
    assert 0.001 < masked.share < raw.share / 5
    surface = seen_again(empty_room(reference, camera), [views[index] for index in mapped], camera)
    assert 5_000 < len(surface) < 20_000
    assert completeness(masked_map, surface).share > 0.9
    half = masked_map[masked_map[:, 0] < np.median(surface[:, 0])]
    assert completeness(half, surface).share == pytest.approx(0.5, abs=0.1)
