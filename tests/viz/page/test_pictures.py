"""Pictures inside a page."""

from base64 import b64decode
from pathlib import Path

import cv2
import numpy as np

from stillroom.viz.page.pictures import LONGEST_PX, SMALL_BYTES, Album, data_uri, evenly


def noise(path: Path, height: int, width: int) -> Path:
    """A smooth picture with noise, which PNG cannot make small."""
    random = np.random.default_rng(0)
    smooth = cv2.resize(random.integers(0, 255, (6, 8, 3), dtype=np.uint8), (width, height))
    cv2.imwrite(str(path), np.clip(smooth.astype(int) + random.integers(-4, 5, smooth.shape), 0, 255).astype(np.uint8))
    return path


def decoded(uri: str) -> np.ndarray:
    picture = cv2.imdecode(np.frombuffer(b64decode(uri.partition(",")[2]), np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return picture


def test_a_small_png_is_taken_as_it_is(tmp_path: Path) -> None:
    path = noise(tmp_path / "a.png", 40, 60)
    uri = data_uri(path)
    assert uri is not None
    assert uri.startswith("data:image/png;base64,")
    assert b64decode(uri.partition(",")[2]) == path.read_bytes()


def test_a_large_one_is_made_smaller(tmp_path: Path) -> None:
    path = noise(tmp_path / "a.png", 960, 1280)
    assert path.stat().st_size > SMALL_BYTES
    uri = data_uri(path)
    assert uri is not None
    assert uri.startswith("data:image/jpeg;base64,")
    shown = decoded(uri)
    assert shown.shape == (720, LONGEST_PX, 3)
    expected = cv2.resize(cv2.imread(str(path)), (LONGEST_PX, 720), interpolation=cv2.INTER_AREA)
    assert np.abs(shown.astype(int) - expected).mean() < 3.0


def test_what_is_no_picture_is_left_out(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"no picture")
    (tmp_path / "b.png").touch()
    album = Album()
    assert [album.figure(tmp_path / name, "x") for name in ("a.png", "b.png", "c.png")] == ["", "", ""]
    assert (album.n_taken, album.n_left_out) == (0, 3)


def test_an_album_ends_where_its_room_does(tmp_path: Path) -> None:
    path = noise(tmp_path / "a.png", 40, 60)
    size = len(data_uri(path) or "")
    album = Album(room_bytes=2 * size + 1)
    figures = [album.figure(path, f"number {n}") for n in range(3)]
    assert [bool(figure) for figure in figures] == [True, True, False]
    assert (album.n_taken, album.n_left_out) == (2, 1)


def test_few_of_many_are_spread_evenly() -> None:
    paths = [Path(f"{n}.png") for n in range(41)]
    assert [int(path.stem) for path in evenly(paths, 5)] == [0, 10, 20, 30, 40]
    assert evenly(paths[:3], 5) == paths[:3]
