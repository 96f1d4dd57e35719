"""Sequences as odd recorders write them: lists with other clocks and units, streams that lost images, other rates."""

import shutil
import zipfile
from collections.abc import Callable, Iterable
from decimal import Decimal
from pathlib import Path, PureWindowsPath

LISTS = ("rgb.txt", "depth.txt")
Stamp = Callable[[int, str], str]
"""The time that a recorder writes for image k, of its time in seconds as the original has it."""


def seconds(k: int, stamp: str) -> str:
    return stamp


def nanoseconds(k: int, stamp: str) -> str:
    return str(int(Decimal(stamp).scaleb(9)))


def milliseconds(k: int, stamp: str) -> str:
    return str(int(Decimal(stamp).scaleb(3).to_integral_value()))


def microseconds(k: int, stamp: str) -> str:
    return str(int(Decimal(stamp).scaleb(6)))


def counter(k: int, stamp: str) -> str:
    return str(k)


def rows_of(path: Path) -> list[tuple[str, str]]:
    """Return times and files of a list as written."""
    lines = path.read_text(encoding="utf-8").splitlines()
    return [tuple(line.split(maxsplit=1)) for line in lines if line.strip() and not line.startswith("#")]


def write_stretch(sequence: Path, folder: Path, first: int, end: int, stamp: Stamp = seconds) -> Path:
    """Make a sequence of a stretch of another: its images stay where they are, its lists have other times."""
    folder.mkdir(parents=True)
    shutil.copy(sequence / "groundtruth.txt", folder)
    for name in LISTS:
        rows = rows_of(sequence / name)[first:end]
        lines = [f"{stamp(k, time)} {(sequence / file).resolve()}" for k, (time, file) in enumerate(rows)]
        (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def restamp(folder: Path, stamp: Stamp, names: Iterable[str] = LISTS) -> None:
    """Rewrite the times of a sequence's lists."""
    for name in names:
        lines = [f"{stamp(k, time)} {file}" for k, (time, file) in enumerate(rows_of(folder / name))]
        (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")


def keep(folder: Path, name: str, places: Iterable[int]) -> None:
    """Keep some rows of a list."""
    rows = rows_of(folder / name)
    (folder / name).write_text("".join(f"{rows[k][0]} {rows[k][1]}\n" for k in places), encoding="utf-8")


def without_lists(folder: Path, name_of: Callable[[str, int], str] = lambda stream, k: f"{k:06d}") -> Path:
    """Make a plain folder of a sequence in the TUM layout: its images are named by stream and place."""
    for stream in ("rgb", "depth"):
        (folder / f"{stream}.txt").unlink()
        for k, path in enumerate(sorted((folder / stream).iterdir())):
            path.rename(path.with_name(f"new_{name_of(stream, k)}{path.suffix}"))
        for path in (folder / stream).iterdir():
            path.rename(path.with_name(path.name.removeprefix("new_")))
    return folder


def associated(folder: Path) -> None:
    """Write one list of four columns in place of two lists, as TUM's `associate.py` does."""
    rgb, depth = (rows_of(folder / name) for name in LISTS)
    lines = [" ".join((*first, *second)) for first, second in zip(rgb, depth, strict=True)]
    (folder / "depth.txt").unlink()
    (folder / "rgb.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


def zip_of_windows(folder: Path, archive: Path) -> Path:
    """Pack a folder with backslashes in its names, and what macOS puts beside files."""
    with zipfile.ZipFile(archive, "w") as packed:
        for path in sorted(folder.rglob("*")):
            inside = str(PureWindowsPath(folder.name, *path.relative_to(folder).parts))
            if path.is_dir():
                packed.writestr(zip_entry(inside + "\\"), b"")
                continue
            packed.writestr(zip_entry(inside), path.read_bytes())
            macos = PureWindowsPath("__MACOSX", folder.name, *path.relative_to(folder).parent.parts, f"._{path.name}")
            packed.writestr(zip_entry(str(macos)), b"\x00\x05\x16\x07 Mac OS X")
    return archive


def zip_entry(name: str) -> zipfile.ZipInfo:
    """Return an entry with a name as it is: `ZipInfo` puts slashes in place of a system's own separators."""
    entry = zipfile.ZipInfo("x")
    entry.filename = name
    return entry
