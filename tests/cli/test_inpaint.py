"""`stillroom inpaint`: images, a video and a contact sheet without people."""

import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from stillroom.datasets.open import open_dataset

STATIC = ("--method", "orb-slam2", "--set", "semantics.kind=truth", "--set", "dynamics.kind=whole-boxes")


def test_people_are_gone_from_images_video_and_sheet(stillroom: Callable, tmp_path: Path) -> None:
    out = tmp_path / "out"
    arguments = ("synthetic:walking", "--frames", "0:45:3", *STATIC, "--set", "semantics.masks=true")
    said = stillroom("inpaint", *arguments, "--every", "6", "--out", out)
    assert said.code == 0, said.err
    assert "of what moved could be painted over" in said.out
    names = sorted(path.name for path in (out / "inpainted").iterdir())
    assert names == [f"inpainted_{index:05d}.png" for index in range(0, 45, 6)]
    people, nobody = open_dataset("synthetic:walking").load(42), open_dataset("synthetic:empty").load(42)
    painted = cv2.imread(str(out / "inpainted" / "inpainted_00042.png"))[..., ::-1].astype(float)
    assert people.truth is not None
    moved = people.truth.movable
    seen = moved & (painted.sum(axis=-1) > 0)
    assert seen.sum() > 0.5 * moved.sum()
    errors = [np.mean((image[seen] - nobody.rgb[seen]) ** 2) for image in (painted, people.rgb.astype(float))]
    assert 10 * np.log10(255**2 / errors[0]) > 25
    assert errors[0] < errors[1] / 5
    # Of all judged frames together, every fifth of the sequence that was given, it says so itself.
    told_db = float(re.search(r"PSNR ([\d.]+) dB against the room without people", said.out)[1])
    assert 25 < told_db < 45
    assert "painted pixels of 2 frames" in said.out  # in the first, nothing had been seen
    video = cv2.VideoCapture(str(out / "inpainted.mp4"))
    assert video.get(cv2.CAP_PROP_FRAME_COUNT) == 15
    assert (out / "inpainting.png").exists()
    assert (out / "trajectory.tum").exists()


def test_images_and_video_can_be_left_out(stillroom: Callable, tmp_path: Path) -> None:
    out = tmp_path / "out"
    said = stillroom("inpaint", "synthetic:empty", "--frames", "0:3", "--method", "orb-slam2", "--every", "0",
                     "--video", "", "--from-map", "--out", out)  # fmt: skip
    assert said.code == 0, said.err
    assert "nothing moved" in said.out
    assert not (out / "inpainted").exists()
    assert not (out / "inpainted.mp4").exists()


def test_what_cannot_be_is_told_before_anything_is_tracked(stillroom: Callable, tmp_path: Path) -> None:
    said = stillroom("inpaint", "synthetic:empty", "--frames", "0:3", "--method", "orb-slam2", "--video", "film.gif",
                     "--out", tmp_path / "out")  # fmt: skip
    assert said.code == 1
    assert len(said.errors) == 1
    assert "film.gif" in said.errors[0]
