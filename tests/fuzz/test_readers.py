"""Every reader is given damaged files: it reads them or says in one line what is wrong, and writes nowhere else.

`STILLROOM_FUZZ=20` gives it twenty times as many. A file that once did harm is kept in `found/<reader>/`, and the
default tests read it.
"""

import os
import shutil
import tarfile
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from mutations import mutations
from rgbd_folder import write_rgbd_folder

import stillroom as sr
from stillroom.data.dense_cloud import load_cloud
from stillroom.data.trajectory import read_tum
from stillroom.datasets.archive import unpack
from stillroom.datasets.camera_file import read_camera, write_camera
from stillroom.datasets.image_sequence import read_depth_units, read_rgb
from stillroom.errors import StillroomError
from stillroom.evaluation.timing import peak_memory_mb
from stillroom.features.places.vocabulary import load_vocabulary
from stillroom.presets.registry import configure
from stillroom.semantics.onnx.onnx_session import open_file
from stillroom.storage.reader import load_map
from stillroom_train.darknet.cfg import read_cfg

FOUND = Path(__file__).parent / "found"
N = 300 * int(os.environ.get("STILLROOM_FUZZ", "1"))
MOST_MEMORY_MB = 2000.0
CFG = """[net]
width=32
height=32
channels=3

[convolutional]
batch_normalize=1
filters=8
size=3
stride=2
pad=1
activation=leaky

[convolutional]
size=1
stride=1
pad=1
filters=21
activation=linear

[yolo]
mask = 0,1,2
anchors = 1,2, 3,4, 5,6
classes=2
num=3
"""


@dataclass(frozen=True)
class Reader:
    """What reads a file of a kind: its name in a folder, an example, and the call."""

    name: str
    example: Callable[[Path], bytes]
    read: Callable[[Path], object]


def _listing(folder: Path) -> bytes:
    return (_sequence(folder) / "rgb.txt").read_bytes()


def _sequence(folder: Path) -> Path:
    place = folder / "sequence"
    if not place.exists():
        write_rgbd_folder(sr.open_dataset("synthetic:empty,frames=3,fps=10"), place)
    return place


def _read_listing(path: Path) -> object:
    """Open a sequence whose list this is."""
    sequence = path.parent / "sequence"
    shutil.copyfile(path, sequence / "rgb.txt")
    dataset = sr.open_dataset(str(sequence))
    return [dataset.load(place) for place in range(min(len(dataset), 3))]


def _camera(folder: Path) -> bytes:
    write_camera(sr.camera("bonn"), folder / "c.toml")
    return (folder / "c.toml").read_bytes()


def _png(folder: Path) -> bytes:
    return bytes(cv2.imencode(".png", np.arange(48 * 64, dtype=np.uint16).reshape(48, 64))[1].tobytes())


def _jpeg(folder: Path) -> bytes:
    return bytes(cv2.imencode(".jpg", np.full((48, 64, 3), 90, np.uint8))[1].tobytes())


def _zip(folder: Path) -> bytes:
    with zipfile.ZipFile(folder / "a.zip", "w") as archive:
        for name in ("room/rgb.txt", "room/rgb/1.png"):
            archive.writestr(name, "content " * 10)
    return (folder / "a.zip").read_bytes()


def _tar(folder: Path) -> bytes:
    (folder / "content.txt").write_text("content " * 10)
    with tarfile.open(folder / "a.tar", "w") as archive:
        for name in ("room/rgb.txt", "room/rgb/1.png"):
            archive.add(folder / "content.txt", name)
    return (folder / "a.tar").read_bytes()


def _unpack(path: Path) -> object:
    into = path.parent / "unpacked"
    shutil.rmtree(into, ignore_errors=True)
    into.mkdir()
    unpack(path, into)
    return None


def _map(folder: Path) -> bytes:
    room = sr.open_dataset("synthetic:empty,frames=4,fps=10")
    with sr.Slam("orb-slam2", room.camera, settings=["dense.kind=nothing"]) as slam:
        for image in room:
            slam.process(image)
    (folder / "m.stillmap").unlink(missing_ok=True)
    slam.save_map(folder / "m.stillmap")
    return (folder / "m.stillmap").read_bytes()


def _cloud(folder: Path) -> bytes:
    points = np.random.default_rng(0).random((20, 3)).astype(np.float32)
    sr.DenseCloud(points, points, (points * 255).astype(np.uint8), points[:, 0], 0.02).write(folder / "c.npz")
    return (folder / "c.npz").read_bytes()


def _vocabulary(folder: Path) -> bytes:
    load_vocabulary(None).save(folder / "v.npz")
    return (folder / "v.npz").read_bytes()


def _onnx(folder: Path) -> bytes:
    import onnx
    from onnx import TensorProto, helper

    values = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 3, 8, 8]) for name in ("x", "y")]
    graph = helper.make_graph([helper.make_node("Relu", ["x"], ["y"])], "g", values[:1], values[1:])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    onnx.checker.check_model(model)
    return bytes(model.SerializeToString())


READERS = {
    "list": Reader("list.txt", _listing, _read_listing),
    "trajectory": Reader(
        "t.tum", lambda folder: b"# t\n" + b"\n".join(b"%d.5 0 0 %d 0 0 0 1" % (k, k) for k in range(9)), read_tum
    ),
    "camera": Reader("camera.toml", _camera, read_camera),
    "config": Reader("config.toml", lambda folder: CONFIG.read_bytes(), lambda path: configure(file=path)),
    "depth": Reader("depth.png", _png, read_depth_units),
    "colour": Reader("colour.jpg", _jpeg, read_rgb),
    "zip": Reader("a.zip", _zip, _unpack),
    "tar": Reader("a.tar", _tar, _unpack),
    "map": Reader("m.stillmap", _map, load_map),
    "cloud": Reader("dense_cloud.npz", _cloud, load_cloud),
    "vocabulary": Reader("v.npz", _vocabulary, load_vocabulary.__wrapped__),
    "onnx": Reader("n.onnx", _onnx, open_file),
    "cfg": Reader("n.cfg", lambda folder: CFG.encode(), read_cfg),
}
CONFIG = Path(__file__).parents[1] / "config" / "old" / "oc-slam.toml"


def read_or_refuse(reader: Reader, content: bytes, folder: Path) -> str:
    """Read a file; return the line that refuses it, or an empty one.

    Raises:
        AssertionError: It is refused by a traceback, or by more than a line, or something was written outside.
    """
    path = folder / "inside" / reader.name
    path.write_bytes(content)
    outside = sorted(each.name for each in folder.iterdir())
    try:
        reader.read(path)
    except StillroomError as error:
        line = str(error)
        assert "\n" not in line, line
        assert line.strip()
        return line
    finally:
        assert sorted(each.name for each in folder.iterdir()) == outside, "something was written outside"
    return ""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "inside").mkdir()
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("kind", READERS)
def test_damage_is_read_or_refused_in_one_line(kind: str, folder: Path) -> None:
    reader = READERS[kind]
    said = set()
    for number, content in enumerate(mutations(reader.example(folder / "inside"), N, number=0)):
        try:
            said.add(read_or_refuse(reader, content, folder))
        except BaseException:
            kept = Path(os.environ.get("STILLROOM_FUZZ_KEEP", str(folder))) / kind
            kept.mkdir(parents=True, exist_ok=True)
            (kept / f"{number}.bin").write_bytes(content)
            raise
    assert "" in said, "not even the sound file was read"
    assert len(said) > 1, "nothing was refused: the damage does not reach the reader"
    assert not peak_memory_mb() > MOST_MEMORY_MB  # unknown on some systems


CASES = sorted(FOUND.glob("*/*")) if FOUND.is_dir() else []


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.parent.name}-{case.name}")
def test_what_once_did_harm_is_refused(case: Path, folder: Path) -> None:
    reader = READERS[case.parent.name]
    reader.example(folder / "inside")
    read_or_refuse(reader, case.read_bytes(), folder)
