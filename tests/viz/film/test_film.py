"""Videos that can be read back, and sheets of pictures."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from stillroom.errors import StillroomError
from stillroom.viz.film import GAP_PX, LABEL_PX, VideoFile, contact_sheet

RED, GREEN = np.zeros((48, 64, 3), np.uint8), np.zeros((48, 64, 3), np.uint8)
RED[..., 0], GREEN[..., 1] = 200, 200


@pytest.mark.parametrize("name", ["film.mp4", "film.avi", "FILM.MP4"])
def test_a_video_shows_its_frames_in_order(name: str, tmp_path: Path) -> None:
    path = tmp_path / "new" / name
    with VideoFile(path, fps=15.0) as video:
        for place in range(12):
            video.add(RED if place < 6 else GREEN)
    read = cv2.VideoCapture(str(path))
    assert read.get(cv2.CAP_PROP_FPS) == pytest.approx(15.0)
    frames = []
    while True:
        there, frame = read.read()
        if not there:
            break
        frames.append(frame[..., ::-1])
    assert len(frames) == 12
    assert frames[0].shape == RED.shape
    for place in (0, 3, 8, 11):
        np.testing.assert_allclose(frames[place].mean(axis=(0, 1)), (RED if place < 6 else GREEN)[0, 0], atol=25)


def test_a_video_without_frames_is_no_file(tmp_path: Path) -> None:
    with VideoFile(tmp_path / "film.mp4", fps=30.0):
        pass
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_written_is_said(tmp_path: Path) -> None:
    with pytest.raises(StillroomError, match=r"film\.gif: .*\.mp4 or \.avi"):
        VideoFile(tmp_path / "film.gif", fps=30.0)
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(StillroomError, match="cannot be written"):
        VideoFile(tmp_path / "taken" / "film.mp4", fps=30.0).add(RED)


def test_a_sheet_holds_all_stacks_in_order() -> None:
    sheet = contact_sheet([(f"{i}", (RED, GREEN)) for i in range(5)], width_px=32, per_row=3)
    height, width = LABEL_PX + 2 * 24 + GAP_PX, 32 + GAP_PX
    assert sheet.shape == (2 * height + GAP_PX, 3 * width + GAP_PX, 3)
    for place in range(6):
        top, left = GAP_PX + (place // 3) * height, GAP_PX + (place % 3) * width
        stack = sheet[top + LABEL_PX : top + LABEL_PX + 48, left : left + 32]
        if place < 5:
            assert np.all(stack[:24] == RED[0, 0])
            assert np.all(stack[24:] == GREEN[0, 0])
            assert (sheet[top : top + LABEL_PX, left : left + 32] < 200).any()  # its label
        else:
            assert np.all(stack == 255)
    assert np.all(contact_sheet([]) == 255)
