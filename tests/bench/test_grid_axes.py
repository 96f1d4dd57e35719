"""The axes of a grid, and what decides that a run is the same as one that is done."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rgbd_folder import write_rgbd_folder

from stillroom.bench.grid import axes
from stillroom.bench.grid.axes import Grid, plan, read_grid, split_values
from stillroom.cli.bench.grid import read_seeds, split_sequences
from stillroom.datasets.camera_file import write_camera
from stillroom.datasets.open import open_dataset
from stillroom.errors import ConfigError
from stillroom.version import __version__

ROOM = "synthetic:walking,frames=60,cache=off"
SMALL = Grid((ROOM,), ("orb-slam2", "oc-slam"), (0, 1), frames="0:20", vary=("tracking.min_inliers=20,30",))


def digests(grid: Grid) -> list[str]:
    return [run.digest for run in plan(grid).runs]


def test_a_grid_is_the_product_of_its_axes_in_order() -> None:
    runs = plan(SMALL).runs
    found = [(run.method, run.setting, run.seed) for run in runs]
    assert found == [
        (method, f"tracking.min_inliers={value}", seed)
        for method in ("orb-slam2", "oc-slam")
        for value in (20, 30)
        for seed in (0, 1)
    ]
    assert len({run.digest for run in runs}) == len(runs) == 8
    assert {run.n_frames for run in runs} == {20}
    assert [(run.config.method, run.config.tracking.min_inliers, run.config.seed) for run in runs] == [
        (method, value, seed) for method in ("orb-slam2", "oc-slam") for value in (20, 30) for seed in (0, 1)
    ]


def test_what_is_the_default_is_the_same_run_as_the_default() -> None:
    usual = replace(SMALL, vary=())
    assert digests(replace(SMALL, vary=("tracking.min_inliers=30",))) == digests(usual)


def test_two_varied_settings_are_two_axes() -> None:
    grid = replace(SMALL, methods=("orb-slam2",), seeds=(0,), vary=("tracking.min_inliers=20,30", "loops.enabled=true"))
    assert [run.setting for run in plan(grid).runs] == [
        "tracking.min_inliers=20 loops.enabled=true",
        "tracking.min_inliers=30 loops.enabled=true",
    ]


def test_the_same_grid_has_the_same_digests_however_it_is_run() -> None:
    assert digests(SMALL) == digests(replace(SMALL, jobs=3, memory_gb=2.0))
    one_more = replace(SMALL, seeds=(0, 1, 2))
    assert set(digests(SMALL)) < set(digests(one_more))


@pytest.mark.parametrize(
    "change",
    [
        {"frames": "0:21"},
        {"set": ("features.n_features=900",)},
        {"sequences": ("synthetic:walking,frames=61,cache=off",)},
        {"sequences": ("synthetic:empty,frames=60,cache=off",)},
    ],
    ids=str,
)
def test_what_decides_a_result_changes_every_digest(change: dict[str, tuple[str, ...]]) -> None:
    assert not set(digests(SMALL)) & set(digests(replace(SMALL, **change)))


def test_another_version_of_stillroom_changes_every_digest(monkeypatch: pytest.MonkeyPatch) -> None:
    before = digests(SMALL)
    monkeypatch.setattr(axes, "code_version", lambda: "99.0 abc")
    assert not set(before) & set(digests(SMALL))
    assert plan(SMALL).runs[0].version == "99.0 abc"


def test_the_version_tells_of_every_change_of_the_sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for package, name in (("stillroom", "system"), ("stillroom_scenes", "raster"), ("stillroom_train", "learner")):
        (tmp_path / package / "room").mkdir(parents=True)
        (tmp_path / package / "room" / f"{name}.py").write_text("a = 1\n", encoding="utf-8")
    monkeypatch.setattr(axes, "__file__", str(tmp_path / "stillroom" / "bench" / "grid" / "axes.py"))
    version = axes.code_version.__wrapped__
    found = [version()]
    for package, name in (("stillroom", "system"), ("stillroom_scenes", "raster")):
        (tmp_path / package / "room" / f"{name}.py").write_text("a = 2\n", encoding="utf-8")
        found.append(version())
    (tmp_path / "stillroom_train" / "room" / "learner.py").write_text("a = 2\n", encoding="utf-8")
    assert version() == found[-1]
    assert len(set(found)) == 3
    assert all(one.startswith(f"{__version__} ") for one in found)


def test_another_calibration_or_ground_truth_changes_the_digest(tmp_path: Path) -> None:
    recorded_room = tmp_path / "room"
    write_rgbd_folder(open_dataset("synthetic:walking,frames=3,fps=10"), recorded_room)
    grid = Grid((str(recorded_room),), ("orb-slam2",))
    before = digests(grid)
    assert digests(grid) == before
    truth = recorded_room / "groundtruth.txt"
    lines = truth.read_text(encoding="utf-8").splitlines()
    moved = lines[-1].split()
    moved[1] = str(float(moved[1]) + 0.001)
    truth.write_text("\n".join([*lines[:-1], " ".join(moved)]) + "\n", encoding="utf-8")
    with_other_truth = digests(grid)
    camera = recorded_room / "camera.toml"
    write_camera(replace(open_dataset(str(recorded_room)).camera, fx=500.0), camera)
    assert len({*before, *with_other_truth, *digests(grid)}) == 3


def test_other_weights_under_the_same_name_change_the_digest(tmp_path: Path) -> None:
    model = tmp_path / "net.onnx"
    grid = Grid((ROOM,), ("oc-slam",), set=("semantics.kind=onnx-boxes", f"semantics.model={model}"), frames="0:9")
    found = []
    for content in (None, b"one", b"two"):
        if content is not None:
            model.write_bytes(content)
        found += digests(grid)
    assert len(set(found)) == 3


def test_a_sequence_that_is_absent_is_planned_for_its_runs_to_say_so() -> None:
    (run,) = plan(Grid(("no-such-sequence",), ("orb-slam2",))).runs
    assert run.n_frames == 0


# Options and files.


def test_a_grid_that_is_written_is_read_back(tmp_path: Path) -> None:
    grid = replace(SMALL, set=("semantics.kind=truth",), jobs=2, memory_gb=1.5, camera="kinect")
    (tmp_path / "grid.toml").write_text(grid.to_toml(), encoding="utf-8")
    assert read_grid(tmp_path / "grid.toml") == grid
    (tmp_path / "grid.toml").write_text(Grid(("a",)).to_toml(), encoding="utf-8")
    assert read_grid(tmp_path / "grid.toml") == Grid(("a",))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('sequence = ["a"]', "unknown key 'sequence'; did you mean 'sequences'?"),
        ('seeds = "0:3"', "it must be a list"),
        ("seeds = [-1]", "0 or more"),
        ('jobs = "two"', "'jobs' is 'two'; it must be a whole number"),
        ("memory_gb = 0.0", "above 0"),
    ],
)
def test_a_slip_in_a_file_is_one_line(text: str, says: str, tmp_path: Path) -> None:
    file = tmp_path / "grid.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=r"grid\.toml") as caught:
        read_grid(file)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"methods": ()}, "methods: names none"),
        ({"methods": ("oc",)}, "did you mean 'oc-slam'"),
        ({"seeds": (0, 0)}, "seeds: names 0 twice"),
        ({"sequences": (ROOM, ROOM)}, "twice"),
        ({"vary": ("tracking.min_inliers",)}, "varies nothing"),
        ({"vary": ("tracking.min_inliers=20,20",)}, "names 20 twice"),
        ({"vary": ("loops.enabled=true", "loops.enabled=false")}, "names 'loops.enabled' twice"),
        ({"vary": ("seed=0,1",)}, "name its values in seeds"),
        ({"set": ("method=oc-slam",)}, "name its values in methods"),
        ({"vary": ("tracking.min_inlier=20",)}, "did you mean 'tracking.min_inliers'"),
    ],
    ids=str,
)
def test_a_slip_in_an_axis_is_one_line(change: dict[str, tuple[str, ...]], says: str) -> None:
    with pytest.raises(ConfigError) as caught:
        plan(replace(SMALL, **change))
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_commas_separate_but_within_brackets_quotes_and_sequences() -> None:
    assert split_values('3, 5,"a,b",[1, 2],[3]') == ["3", "5", '"a,b"', "[1, 2]", "[3]"]
    assert split_values(" , ") == []
    names = "synthetic:walking,frames=60, fps=10,rgbd_bonn_crowd,synthetic:empty"
    assert split_sequences(names) == ["synthetic:walking,frames=60, fps=10", "rgbd_bonn_crowd", "synthetic:empty"]


def test_seeds_are_a_list_or_a_range() -> None:
    assert read_seeds("0,2, 5") == (0, 2, 5)
    assert read_seeds("2:5") == (2, 3, 4)
    assert read_seeds(":3") == (0, 1, 2)
    with pytest.raises(ConfigError, match="write it like 0,1,2 or 0:3"):
        read_seeds("0-3")


def test_all_methods_are_every_method() -> None:
    runs = plan(replace(SMALL, methods=("all",), seeds=(0,), vary=())).runs
    assert {"orb-slam2", "oc-slam", "pspnet-slam", "dynaslam"} <= {run.method for run in runs}
    assert len(np.unique([run.digest for run in runs])) == len(runs)
