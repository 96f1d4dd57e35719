"""A run that found no pose says so by its exit code, and why in one line."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from stillroom.data.image import RgbdImage
from stillroom.data.result import FrameSummary, TrackingState
from stillroom.datasets.open import open_dataset
from stillroom.pipeline.untracked import Seen, likely_reason

FEW = ("--pictures", "0", "--method", "orb-slam2", "--frames", ":4", "--out", "out")


def overwrite(folder: Path, change: Callable[[np.ndarray], np.ndarray]) -> None:
    for path in folder.iterdir():
        pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert pixels is not None
        cv2.imwrite(str(path), change(pixels))


def a_corner(units: np.ndarray) -> np.ndarray:
    left = np.zeros_like(units)
    left[:40, :40] = units[:40, :40]
    return left


DAMAGES: dict[str, tuple[Callable[[Path], object], str]] = {
    "depth is zero": (lambda room: overwrite(room / "depth", np.zeros_like), "4 of 4 images have no depth anywhere"),
    "all is black": (lambda room: overwrite(room / "rgb", np.zeros_like), "4 of 4 images are black"),
    "all is grey": (lambda room: overwrite(room / "rgb", lambda rgb: np.full_like(rgb, 99)), "images show too little"),
    "depth is a corner": (lambda room: overwrite(room / "depth", a_corner), "too few keypoints have a depth"),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_the_exit_code_is_3_and_the_reason_is_said(name: str, stillroom: Callable, recorded: Path) -> None:
    damage, expected = DAMAGES[name]
    damage(recorded)
    said = stillroom("run", recorded, *FEW)
    assert said.code == 3
    [error] = said.errors
    assert expected in error
    assert error.endswith("[see troubleshooting: nothing-tracked]")
    assert "0 of 4 frames tracked" in said.out
    assert "no ground truth" not in said.out
    assert Path("out/metrics.json").exists()


@pytest.mark.parametrize("row", [0, 1, 239, 479])
def test_one_pixel_is_enough_wherever_it_is(row: int) -> None:
    rgb, depth_m = np.zeros((480, 640, 3), np.uint8), np.zeros((480, 640), np.float32)
    seen = Seen()
    assert seen.add(RgbdImage(0.0, rgb, depth_m)) == (True, False)
    rgb[row, 17, 1] = 8
    assert seen.add(RgbdImage(0.0, rgb, depth_m)) == (False, True)
    depth_m[row, 17] = 1.0
    assert seen.add(RgbdImage(0.0, rgb, depth_m)) == (False, False)
    assert (seen.n_images, seen.n_black, seen.n_without_depth) == (3, 1, 1)


def test_reasons_that_no_recorded_room_has() -> None:
    assert likely_reason(Seen(), [], None) == "no image could be read"
    result = FrameSummary(0, 0.0, TrackingState.NOT_INITIALIZED, None, 800, 30, 0, 0, False, -1, None)
    assert likely_reason(Seen(1), [result], None).startswith("nearly all was taken for moving: of 800 keypoints 30")


def test_localizing_in_another_room(stillroom: Callable, recorded: Path) -> None:
    assert stillroom("run", recorded, *FEW, "--map", "room.stillmap").code == 0
    other = "synthetic:building"
    assert len(open_dataset(other)) > 4
    said = stillroom("run", other, *FEW[:-1], "other", "--map", "room.stillmap", "--localize")
    assert said.code == 3
    [error] = said.errors
    assert "no place of room.stillmap was recognised in 4 images" in error


def test_without_ground_truth_that_is_what_is_said(stillroom: Callable, recorded: Path) -> None:
    (recorded / "groundtruth.txt").unlink()
    said = stillroom("run", recorded, *FEW)
    assert (said.code, said.errors) == (0, [])
    assert "4 of 4 frames tracked (100.0 %); no ground truth to compare with" in said.out


def test_with_it_a_single_pose_is_too_little(stillroom: Callable, recorded: Path) -> None:
    said = stillroom("run", recorded, "--frames", ":1", "--pictures", "0", "--out", "out")
    assert said.code == 0
    assert "no ground truth" not in said.out


def test_a_map_that_was_dropped_is_nothing(stillroom: Callable, freiburg1_xyz: Path) -> None:
    """Images of it were tracked for a while, and have no pose in the end."""
    only = ("--sensor", "monocular", "--pictures", "0", "--no-report", "--method", "orb-slam2", "--out", "out")
    said = stillroom("run", freiburg1_xyz, "--frames", ":14", "--blackout", "12:14", *only)
    assert "0 of" in said.out
    assert "1 map was dropped" in said.out
    assert said.code == 3
    [error] = said.errors
    assert "every map that was begun was lost soon after, and dropped" in error


def test_going_on_in_a_map_of_which_no_place_is_recognised(stillroom: Callable, recorded: Path) -> None:
    assert stillroom("run", recorded, *FEW, "--map", "room.stillmap").code == 0
    for path in (recorded / "rgb").iterdir():
        noise = np.random.default_rng(len(path.stem)).integers(0, 255, (480, 640, 3), dtype=np.uint8)
        cv2.imwrite(str(path), noise)
    said = stillroom("run", recorded, *FEW[:-1], "other", "--map", "room.stillmap", "--continue")
    assert said.code == 3
    [error] = said.errors
    assert "no place of room.stillmap was recognised in" in error
