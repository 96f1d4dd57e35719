"""Folders in the TUM layout for tests: frames of a data set as images, or the first frames of a real sequence."""

from pathlib import Path

import cv2
import numpy as np

from stillroom.datasets.camera_file import write_camera
from stillroom.protocols import Dataset

LISTS = ("rgb.txt", "depth.txt")


def write_rgbd_folder(dataset: Dataset, folder: Path) -> None:
    """Write all frames of a data set with ground truth, its camera, and the lists that name them."""
    lines: dict[str, list[str]] = {name: [] for name in LISTS}
    for place in range(len(dataset)):
        image = dataset.load(place)
        units = np.rint(image.depth_m * dataset.camera.depth_factor).astype(np.uint16)
        pictures = {"rgb": cv2.cvtColor(image.rgb, cv2.COLOR_RGB2BGR), "depth": units}
        for name, pixels in pictures.items():
            file = folder / name / f"{image.timestamp_s:.6f}.png"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(cv2.imencode(".png", pixels)[1].tobytes())
            lines[f"{name}.txt"].append(f"{image.timestamp_s:.6f} {name}/{file.name}")
    for name, rows in lines.items():
        (folder / name).write_text("\n".join(rows) + "\n", encoding="utf-8")
    write_camera(dataset.camera, folder / "camera.toml")
    assert dataset.groundtruth is not None
    dataset.groundtruth.write_tum(folder / "groundtruth.txt")


def write_first_frames(sequence: Path, folder: Path, frames: int) -> None:
    """Make a sequence of the first frames of another: its lists are cut, its images stay where they are."""
    folder.mkdir(parents=True)
    (folder / "groundtruth.txt").write_bytes((sequence / "groundtruth.txt").read_bytes())
    for name in LISTS:
        rows = (sequence / name).read_text(encoding="utf-8").splitlines()
        images = [row for row in rows if row.strip() and not row.startswith("#")][:frames]
        absolute = [f"{row.split()[0]} {(sequence / row.split()[1]).resolve()}" for row in images]
        (folder / name).write_text("\n".join(absolute) + "\n", encoding="utf-8")
