"""A plain folder of images: times from names, from lists or from a frame rate, and never guessed."""

from pathlib import Path

import numpy as np
import pytest

from stillroom.datasets.folder import open_folder
from stillroom.datasets.open import open_dataset
from stillroom.errors import CalibrationError, ConfigError, DatasetError


@pytest.fixture
def plain(tiny: Path) -> Path:
    """The tiny sequence without lists; its file names are seconds."""
    for name in ("rgb.txt", "depth.txt"):
        (tiny / name).unlink()
    return tiny


def rename(folder: Path, pattern: str, names: tuple[str, ...] = ("rgb", "depth")) -> None:
    for name in names:
        for k, path in enumerate(sorted((folder / name).iterdir())):
            path.rename(path.with_name(pattern.format(k=k, ns=1403636579763555584 + k * 50_000_000) + ".png"))


def depths(sequence) -> list[float]:
    return [float(sequence.load(i).depth_m[0, 0]) for i in range(len(sequence))]


IN_ORDER = pytest.approx([1.5, 1.6, 1.7, 1.8, 1.9, 2.0])


def test_names_in_seconds_are_times(plain: Path) -> None:
    sequence = open_dataset(str(plain))
    assert sequence.timestamps_s == pytest.approx(1305031229.5 + np.arange(6) / 30, abs=1e-5)
    assert depths(sequence) == IN_ORDER
    assert sequence.groundtruth is not None


def test_names_of_19_digits_are_nanoseconds(plain: Path) -> None:
    rename(plain, "{ns}")
    sequence = open_folder(plain)
    assert sequence.timestamps_s == pytest.approx(1403636579.763555584 + 0.05 * np.arange(6), abs=1e-6)
    assert depths(sequence) == IN_ORDER


def test_lists_are_followed(tiny: Path) -> None:
    assert depths(open_folder(tiny)) == IN_ORDER


@pytest.mark.parametrize("pattern", ["{k:06d}", "frame{k}", "{k}"])
def test_frame_numbers_need_a_rate(pattern: str, plain: Path) -> None:
    rename(plain, pattern)
    with pytest.raises(DatasetError, match=r"tells no time .*give the frame rate"):
        open_folder(plain)
    sequence = open_dataset(str(plain), fps=25.0)
    assert sequence.timestamps_s == pytest.approx(np.arange(6) / 25)
    assert depths(sequence) == IN_ORDER


def test_numbers_in_names_sort_as_numbers(plain: Path) -> None:
    for name in ("rgb", "depth"):
        for k, path in enumerate(sorted((plain / name).iterdir())):
            path.rename(path.with_name(f"frame{k + 7}.png"))  # 7 8 9 10 11 12
    assert depths(open_folder(plain, fps=30.0)) == IN_ORDER


def test_other_names_for_depth_pair_in_order(plain: Path) -> None:
    rename(plain, "colour{k}", ("rgb",))
    rename(plain, "depth{k}", ("depth",))
    assert depths(open_folder(plain, fps=30.0)) == IN_ORDER


def test_equal_names_pair_even_where_depth_has_more(plain: Path) -> None:
    rename(plain, "{k}")
    (plain / "rgb" / "2.png").unlink()
    assert depths(open_folder(plain, fps=30.0)) == pytest.approx([1.5, 1.6, 1.8, 1.9, 2.0])


def test_two_names_for_one_time_are_said(plain: Path) -> None:
    first = sorted((plain / "rgb").iterdir())[0]
    (plain / "rgb" / "1305031229.50.png").write_bytes(first.read_bytes())
    with pytest.raises(DatasetError, match=r"rgb/1305031229\.50+\.png: the timestamp 1305031229\.500000 repeats"):
        open_folder(plain)


@pytest.mark.parametrize("name", ["rgb", "depth"])
def test_an_empty_or_missing_image_folder_is_said(name: str, plain: Path) -> None:
    for path in (plain / name).iterdir():
        path.unlink()
    with pytest.raises(DatasetError, match=f"{name}: no images in it"):
        open_folder(plain)
    (plain / name).rmdir()
    with pytest.raises(DatasetError, match=f"no folder {name}/ in it"):
        open_folder(plain)


def test_without_a_camera_says_how_to_give_one(plain: Path) -> None:
    (plain / "camera.toml").unlink()
    with pytest.raises(CalibrationError, match=r"put a camera\.toml into the folder"):
        open_dataset(str(plain))


@pytest.mark.parametrize("fps", [0.0, -1.0, float("nan"), float("inf")])
def test_an_impossible_rate_is_said(fps: float, plain: Path) -> None:
    with pytest.raises(ConfigError, match="fps is"):
        open_folder(plain, fps=fps)


def test_an_impossible_rate_is_said_before_what_is_wrong_with_the_folder(tiny: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    named_like_bonn = tiny.rename(tmp_path / "rgbd_bonn_tiny")
    for folder in (tmp_path / "empty", named_like_bonn):
        with pytest.raises(ConfigError, match="fps is -1"):
            open_dataset(str(folder), fps=-1.0)
    with pytest.raises(DatasetError, match=r"empty: no rgb\.txt and no folder rgb/ in it"):
        open_dataset(str(tmp_path / "empty"))


def test_a_bare_name_is_sought_where_data_lies(tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STILLROOM_DATA", str(tmp_path))
    monkeypatch.chdir(tmp_path / "tiny" / "rgb")
    assert open_dataset("tiny").name == "tiny"
    with pytest.raises(DatasetError, match=f"tinny: no such folder or archive here, nor in {tmp_path}, .*download"):
        open_dataset("tinny")


def test_a_rendered_sequence_takes_no_camera() -> None:
    with pytest.raises(ConfigError, match="brings its own camera"):
        open_dataset("synthetic:walking", camera="fr1")
