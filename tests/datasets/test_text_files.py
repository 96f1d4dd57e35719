"""Text that is not what it seems is read where its meaning is sure, and named for what it is where it is not."""

import codecs
import logging
import zipfile
from pathlib import Path

import numpy as np
import pytest
from tests.fabricated.recorders import LISTS, associated, counter, restamp, rows_of, zip_entry, zip_of_windows

from stillroom.config.settings import read_toml
from stillroom.data.trajectory import read_tum
from stillroom.datasets.folder import open_folder
from stillroom.datasets.open import open_dataset
from stillroom.datasets.pairing import Pairing
from stillroom.datasets.tum import open_tum
from stillroom.errors import DatasetError, TrajectoryError

ROW = "[see troubleshooting: text-files]"
TEXTS = (*LISTS, "groundtruth.txt", "camera.toml")


def rewrite(path: Path, change) -> None:
    path.write_bytes(change(path.read_text(encoding="utf-8")))


def same(first, second) -> bool:
    return (
        np.array_equal(first.timestamps_s, second.timestamps_s)
        and (first.rgb_files, first.depth_files) == (second.rgb_files, second.depth_files)
        and np.array_equal(first.groundtruth.T_world_cam, second.groundtruth.T_world_cam)
        and first.camera == second.camera
    )


READ = {
    "a byte order mark": lambda text: codecs.BOM_UTF8 + text.encode(),
    "lines as Windows ends them": lambda text: text.replace("\n", "\r\n").encode(),
    "both": lambda text: codecs.BOM_UTF8 + text.replace("\n", "\r\n").encode(),
}


@pytest.mark.parametrize("case", list(READ))
def test_what_editors_add_is_no_part_of_a_text(case: str, tiny: Path) -> None:
    right = open_tum(tiny)
    for name in TEXTS:
        rewrite(tiny / name, READ[case])
    assert same(open_tum(tiny), right)


def test_a_header_without_a_mark_is_a_header(tiny: Path) -> None:
    right = open_tum(tiny)
    for name, header in (*((name, "timestamp filename") for name in LISTS), ("groundtruth.txt", "timestamp tx ty tz")):
        rewrite(tiny / name, lambda text, header=header: (header + "\n" + text.replace("#", "# ")).encode())
    assert same(open_tum(tiny), right)
    rows = rows_of(tiny / "rgb.txt")
    assert rows[0] == ("timestamp", "filename")
    (tiny / "rgb.txt").write_text("\n".join(" ".join(row) for row in [*rows[1:3], rows[0]]) + "\n")
    with pytest.raises(DatasetError, match=r"rgb\.txt:3: 'timestamp' is no timestamp"):
        open_tum(tiny)


def test_commas_and_backslashes_in_lists_are_read(tiny: Path) -> None:
    right = open_tum(tiny)
    rewrite(tiny / "rgb.txt", lambda text: text.replace(" rgb/", ",rgb\\").replace("# ", "#").encode())
    rewrite(tiny / "depth.txt", lambda text: text.replace(" depth/", ", depth\\").encode())
    assert same(open_tum(tiny), right)


def test_a_decimal_comma_is_no_separator(tiny: Path) -> None:
    rewrite(tiny / "rgb.txt", lambda text: text.replace("1305031229.", "1305031229,").encode())
    with pytest.raises(DatasetError, match=r"'1305031229,\d+' is no timestamp"):
        open_tum(tiny)


def test_four_columns_are_pairs(tiny: Path, caplog: pytest.LogCaptureFixture) -> None:
    right = open_tum(tiny)
    restamp(tiny, lambda k, time: f"{float(time) + 5:.6f}", ["depth.txt"])  # no pair by time
    associated(tiny)
    assert same(open_tum(tiny), right)
    said = [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]
    assert len(said) == 1
    assert "rgb.txt: has four columns" in said[0]
    assert said[0].endswith(ROW)


def test_four_columns_of_counted_images_need_a_rate(tiny: Path) -> None:
    restamp(tiny, counter)
    associated(tiny)
    with pytest.raises(DatasetError, match="time-unit"):
        open_tum(tiny)
    assert open_tum(tiny, fps=10.0).timestamps_s == pytest.approx(0.1 * np.arange(6))
    assert open_tum(tiny, pairing=Pairing(time_unit="ms")).timestamps_s == pytest.approx(0.001 * np.arange(6))


def test_four_columns_are_named_where_they_cannot_be_meant(tiny: Path) -> None:
    lines = (tiny / "rgb.txt").read_text(encoding="utf-8").splitlines()
    associated(tiny)
    four = (tiny / "rgb.txt").read_text(encoding="utf-8")
    (tiny / "depth.txt").write_text(four, encoding="utf-8")
    (tiny / "rgb.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    with pytest.raises(DatasetError, match=r"depth\.txt: has four columns, .*save it as rgb\.txt") as caught:
        open_tum(tiny)
    assert str(caught.value).endswith(ROW)
    (tiny / "rgb.txt").write_text(lines[2] + "\n" + four, encoding="utf-8")
    with pytest.raises(DatasetError, match=r"rgb\.txt:2: two columns in some lines and four in others"):
        open_tum(tiny)


def test_utf_16_is_named(tiny: Path) -> None:
    for name, error in (("groundtruth.txt", TrajectoryError), ("rgb.txt", DatasetError)):
        rewrite(tiny / name, lambda text: text.encode("utf-16"))
        with pytest.raises(error, match=r"it is UTF-16; save it as UTF-8\) \[see troubleshooting: text-files\]"):
            read_tum(tiny / name) if error is TrajectoryError else open_tum(tiny)


def test_files_of_macos_are_no_images(tiny: Path) -> None:
    right = open_tum(tiny)
    for name in LISTS:
        for path in list((tiny / name.removesuffix(".txt")).iterdir()):
            path.with_name(f"._{path.name}").write_bytes(b"\x00\x05\x16\x07 Mac OS X")
        rows = rows_of(tiny / name)
        both = [(f"{float(t) - 0.001:.6f}", f.replace("/", "/._")) for t, f in rows]
        lines = [" ".join(row) for pair in zip(both, rows, strict=True) for row in pair]
        (tiny / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert same(open_tum(tiny), right)
    for name in LISTS:
        (tiny / name).unlink()
    assert len(open_folder(tiny)) == 6


def test_a_zip_with_backslashes_and_files_of_macos_is_read(tiny: Path, tmp_path: Path) -> None:
    right = open_tum(tiny)
    sequence = open_dataset(str(zip_of_windows(tiny, tmp_path / "packed.zip")))
    assert np.array_equal(sequence.timestamps_s, right.timestamps_s)
    assert [path.name for path in sequence.rgb_files] == [path.name for path in right.rgb_files]
    assert sequence.load(3).depth_m[0, 0] == right.load(3).depth_m[0, 0]
    assert sequence.rgb_files[0].parent.parent.name == "tiny"


def test_backslashes_lead_out_of_no_archive(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "evil.zip", "w") as packed:
        packed.writestr(zip_entry("..\\..\\outside.txt"), b"out")
    with pytest.raises(DatasetError, match="leads out of it"):
        open_dataset(str(tmp_path / "evil.zip"))


def test_a_config_with_a_byte_order_mark_is_read(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_bytes(codecs.BOM_UTF8 + b"seed = 3\n")
    assert read_toml(tmp_path / "mine.toml")["seed"] == 3
