"""What of a rendered scene is static in the end: the chair where it was left, not where it was."""

import numpy as np
import pytest

from stillroom.evaluation.ghost_truth import distances_to_patches_m
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64
from stillroom_scenes.config import open_synthetic
from stillroom_scenes.room import SyntheticRoom

STEP_PX = 6


def seen_points(room: SyntheticRoom, index: int) -> tuple[F64, np.ndarray]:
    truth = room.truth(index)
    rows, columns = np.mgrid[0 : room.camera.height : STEP_PX, 0 : room.camera.width : STEP_PX]
    px = np.stack((columns.ravel(), rows.ravel()), axis=1).astype(np.float64)
    points = room.camera.back_project(px, truth.depth_m[rows, columns].ravel())
    return se3.transform(truth.T_world_cam, points), truth.instance[rows, columns].ravel()


@pytest.mark.parametrize("figures", ["walking", "pushed", "carried"])
def test_pixels_that_stay_lie_on_the_static_surface_and_others_off_it(figures: str) -> None:
    room = open_synthetic(f"synthetic:{figures},cache=off,noise=off")
    remains = room.remains()
    n_moving = 0
    for index in range(5, len(room), 60):
        points, instance = seen_points(room, index)
        stays = remains.stays(instance[None], float(room.timestamps_s[index]))[0]
        off_m = distances_to_patches_m(points, remains.patches_m, remains.is_triangle)
        assert off_m[stays].max() < 1e-4
        # Only feet touch the floor, hands what they hold, and the thing itself its later place.
        assert np.median(off_m[~stays]) > 0.05 if (~stays).sum() > 50 else True
        n_moving += int((~stays).sum())
    assert n_moving > 1000


@pytest.mark.parametrize("figures", ["pushed", "carried"])
def test_a_moved_thing_is_static_from_where_it_was_left(figures: str) -> None:
    room = open_synthetic(f"synthetic:{figures},frames=420,cache=off")
    (thing,) = room.scene.objects
    plan = thing.handling
    assert 0 < plan.taken_s < plan.left_s < room.timestamps_s[-1]
    remains = room.remains()
    pixel = np.array([[thing.instance, 0, 1]], dtype=np.uint8)
    for time_s, there in ((0.0, False), (plan.taken_s + 0.1, False), (plan.left_s - 0.1, False), (plan.left_s, True)):
        np.testing.assert_array_equal(remains.stays(pixel, time_s), [[there, True, False]])
    before, after = (thing.patches(time_s).shape_m[:, :3] for time_s in (0.0, plan.left_s + 1.0))
    corners = remains.patches_m[:, :3]
    assert len(remains.patches_m) == len(room.scene.still) + len(after)
    for corner in after:
        assert np.abs(corners - corner).max(axis=1).min() < 1e-9
    assert distances_to_patches_m(before, remains.patches_m, remains.is_triangle).max() > 0.2


def test_what_a_sequence_ends_before_does_not_count() -> None:
    room = open_synthetic("synthetic:pushed,frames=420,cache=off")
    (chair,) = room.scene.objects
    pixel = np.array([[chair.instance]], dtype=np.uint8)
    untouched = room.remains(int(chair.handling.taken_s * 30) - 2)
    assert untouched.stays(pixel, 0.0).all()
    assert len(untouched.patches_m) == len(room.scene.still) + len(chair.rest)
    on_its_way = room.remains(int((chair.handling.taken_s + chair.handling.left_s) * 15))
    assert not on_its_way.stays(pixel, 0.0).any()
    assert len(on_its_way.patches_m) == len(room.scene.still)
    with pytest.raises(IndexError):
        room.remains(420)


def test_figures_never_stay() -> None:
    room = open_synthetic("synthetic:standing,frames=60,cache=off")
    instances = np.array([[figure.instance for figure in room.scene.figures]], dtype=np.uint8)
    assert not room.remains().stays(instances, 0.0).any()
