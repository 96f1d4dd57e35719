"""Packages beside Stillroom add a data set and a segmenter by one file each; what is wrong with one is one line.

The packages lie under `tests/outside/` as pip would install them: a module, and a `*.dist-info/` that names its entry
points.
"""

import sys
import tarfile
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from stillroom.cameras.registry import open_camera
from stillroom.config import SlamConfig, to_toml, updated, with_overrides
from stillroom.config.kinds import DYNAMICS, SEMANTICS
from stillroom.datasets.open import open_dataset
from stillroom.datasets.registry import LAST, all_kinds
from stillroom.errors import ConfigError, DatasetError
from stillroom.presets.registry import all_methods
from stillroom.testing.camera_contract import check_camera
from stillroom.testing.dataset_contract import KnownPixel, check_dataset
from stillroom.testing.segmenter_contract import check_segmenter
from stillroom.testing.tiny_sequence import write_tiny_sequence

OUTSIDE = Path(__file__).parents[1] / "outside"
RED = (220, 20, 30)


@pytest.fixture
def noise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(OUTSIDE / "noise_dataset")


@pytest.fixture
def red_things(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(OUTSIDE / "red_segmenter")


Install = Callable[[str, str, str], None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """Install a package with one module and one entry point: the group, the line, and the source of the module."""

    def into_new_folder(group: str, line: str, source: str) -> None:
        folder = tmp_path / "installed"
        (folder / "mine-1.0.dist-info").mkdir(parents=True)
        (folder / "mine-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
        (folder / "mine-1.0.dist-info" / "entry_points.txt").write_text(f"[{group}]\n{line}\n")
        (folder / "mine_of_a_test.py").write_text(source)
        monkeypatch.delitem(sys.modules, "mine_of_a_test", raising=False)
        monkeypatch.syspath_prepend(folder)

    return into_new_folder


@pytest.mark.usefixtures("noise")
def test_an_outside_data_set_keeps_the_contract() -> None:
    dataset = open_dataset("noise:12")
    assert (dataset.name, len(dataset)) == ("noise_12", 12)
    check_dataset(dataset, KnownPixel(5, 12, 11, RED, 1.5), KnownPixel(5, 47, 63, rgb_of(dataset, 5), 2.0))
    with pytest.raises(DatasetError, match="'many' is no number of images"):
        open_dataset("noise:many")


def rgb_of(dataset: object, index: int) -> tuple[int, int, int]:
    return tuple(dataset.load(index).rgb[47, 63].tolist())  # type: ignore[attr-defined]


@pytest.mark.usefixtures("noise")
def test_an_outside_kind_is_asked_about_folders_and_archives_before_the_plain_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    kinds = all_kinds()
    assert list(kinds) == ["bonn", "euroc", "kitti", "noise", "synthetic", "folder"]
    assert kinds["folder"] is LAST
    folder = tmp_path / "both"
    write_tiny_sequence(folder)
    assert len(open_dataset(str(folder))) == 6
    (folder / "noise.txt").write_text("9\n")
    assert (open_dataset(str(folder)).name, len(open_dataset(str(folder)))) == ("both", 9)
    with tarfile.open(tmp_path / "packed.tgz", "w:gz") as tar:
        tar.add(folder / "noise.txt", arcname="inner/noise.txt")
    packed = open_dataset(str(tmp_path / "packed.tgz"))
    assert (packed.name, len(packed)) == ("inner", 9)


@pytest.mark.usefixtures("noise", "red_things")
def test_an_outside_segmenter_keeps_the_contract() -> None:
    config = with_overrides(SlamConfig(), ["semantics.kind=red-things", "semantics.least_red=200"])
    dataset = open_dataset("noise:6")
    images = [dataset.load(index) for index in range(len(dataset))]
    answers = check_segmenter(config.semantics.build, images)
    for image, answer in zip(images, answers, strict=True):
        assert answer.mask is not None
        assert (answer.mask == (image.depth_m < 2.0)).all()


@pytest.mark.usefixtures("red_things")
def test_an_outside_kind_is_named_like_the_house_s_own() -> None:
    config = with_overrides(SlamConfig(), ["semantics.kind=red-things", "semantics.most_other=40"])
    assert SEMANTICS.name_of(config.semantics) == "red-things"
    text = to_toml(config)
    assert 'kind = "red-things"  # nothing | yolo-fastest' in text
    assert "truth | red-things\n" in text
    assert updated(SlamConfig(), tomllib.loads(text)) == config
    with pytest.raises(ConfigError, match=r"'red-thing'; did you mean 'red-things'\? known: nothing, .*, red-things$"):
        with_overrides(SlamConfig(), ["semantics.kind=red-thing"])


def test_an_outside_camera_keeps_the_contract(install: Install, tmp_path: Path) -> None:
    install(
        "stillroom.cameras",
        "mine = mine_of_a_test:KIND",
        "from stillroom.cameras.kind import CameraKind\nfrom stillroom.cameras.replay import open_replay\n"
        "KIND = CameraKind('mine', 'camera:mine:FOLDER', 'a camera of mine', open_replay)\n",
    )
    write_tiny_sequence(tmp_path / "tiny")
    assert len(check_camera(lambda: open_camera(f"camera:mine:{tmp_path / 'tiny'}"))) == 5
    with pytest.raises(ConfigError, match=r"'yours'; there is: camera:replay.*camera:oak\[:ID\], camera:mine:FOLDER$"):
        open_camera("camera:yours")


def test_an_outside_sieve_stands_alone_or_in_a_chain(install: Install) -> None:
    install(
        "stillroom.sieves",
        "mine = mine_of_a_test:MineConfig",
        "from dataclasses import dataclass\nfrom stillroom.dynamics.chain import KeepAllConfig\n"
        "@dataclass(frozen=True)\nclass MineConfig(KeepAllConfig):\n    threshold_px: float = 3.0\n",
    )
    alone = with_overrides(SlamConfig(), ["dynamics.kind=mine", "dynamics.threshold_px=2"]).dynamics
    assert (DYNAMICS.name_of(alone), alone.threshold_px) == ("mine", 2.0)  # type: ignore[attr-defined]
    config = with_overrides(SlamConfig(), ["dynamics.kind=chain", "dynamics.second.kind=mine"])
    assert type(config.dynamics.second) is type(alone)  # type: ignore[attr-defined]
    assert updated(SlamConfig(), tomllib.loads(to_toml(config))) == config


def test_a_wrong_entry_beside_a_good_one_is_said_in_one_line(install: Install) -> None:
    install(
        "stillroom.segmenters",
        "absent = mine_of_a_test:Absent\nmine = mine_of_a_test:MineConfig",
        "from dataclasses import dataclass\nfrom stillroom.semantics.no_segmenter import NothingConfig\n"
        "@dataclass(frozen=True)\nclass MineConfig(NothingConfig):\n    pass\n",
    )
    with pytest.raises(ConfigError, match=r"^entry point 'absent' of mine, .*: cannot be imported \(AttributeError"):
        to_toml(with_overrides(SlamConfig(), ["semantics.kind=mine"]))


def choose(section: str, kind: str) -> Callable[[], object]:
    return lambda: with_overrides(SlamConfig(), [f"{section}.kind={kind}"])


DOORS = {
    "stillroom.methods": (all_methods, "must be a Method"),
    "stillroom.datasets": (lambda: open_dataset("synthetic:empty,frames=1,cache=off"), "must be a DatasetKind"),
    "stillroom.cameras": (
        lambda: open_camera("camera:replay:synthetic:empty,frames=1,cache=off"),
        "must be a CameraKind",
    ),
    "stillroom.segmenters": (choose("semantics", "mine"), "must be a dataclass with a build method"),
    "stillroom.sieves": (choose("dynamics", "mine"), "must be a dataclass with a build method"),
}


def refused(group: str) -> str:
    """Return what is said when a door is used."""
    with pytest.raises(ConfigError) as caught:
        DOORS[group][0]()
    message = str(caught.value)
    assert message.startswith("entry point '")
    assert f"of mine, group {group}: " in message
    assert "\n" not in message
    return message


@pytest.mark.parametrize("group", DOORS)
def test_what_cannot_be_imported_is_said(group: str, install: Install) -> None:
    install(group, "mine = mine_of_a_test:absent", "import no_such_package_anywhere\n")
    assert "cannot be imported (ModuleNotFoundError: No module named 'no_such_package_anywhere')" in refused(group)


@pytest.mark.parametrize("group", DOORS)
def test_what_fails_on_import_or_is_not_there_is_said(group: str, install: Install) -> None:
    install(group, "mine = mine_of_a_test:absent", "X = {}['key']\n")
    assert "cannot be imported (KeyError: 'key')" in refused(group)


@pytest.mark.parametrize("group", DOORS)
def test_what_is_of_another_type_is_said(group: str, install: Install) -> None:
    install(group, "mine = mine_of_a_test:Mine", "class Mine:\n    pass\n")
    assert f"'mine_of_a_test:Mine' is a class Mine; it {DOORS[group][1]}" in refused(group)


@pytest.mark.parametrize(
    ("group", "line", "source", "said"),
    [
        (
            "stillroom.methods",
            "mine = mine_of_a_test:METHOD",
            "from stillroom.presets.registry import OWN\nMETHOD = OWN[2]\n",
            "there is a method 'oc-slam' already",
        ),
        (
            "stillroom.datasets",
            "mine = mine_of_a_test:KIND",
            "from stillroom.datasets.folder import KIND\n",
            "there is a kind of data set 'folder' already",
        ),
        (
            "stillroom.cameras",
            "mine = mine_of_a_test:KIND",
            "from stillroom.cameras.oak import KIND\n",
            "there is a kind of camera 'oak' already",
        ),
        ("stillroom.segmenters", "truth = mine_of_a_test:A", "", "there is a segmenter 'truth' already"),
        ("stillroom.sieves", "epipolar = mine_of_a_test:A", "", "there is a match sieve 'epipolar' already"),
    ],
)
def test_a_name_that_is_taken_is_refused(group: str, line: str, source: str, said: str, install: Install) -> None:
    install(group, line, source)
    assert f"{said}; it needs another name" in refused(group)
