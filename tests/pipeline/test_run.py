"""A run from images to results folder."""

import csv
import json
import signal
import tomllib
import weakref
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from stillroom.config import SlamConfig, read_toml, updated
from stillroom.data.image import RgbdImage
from stillroom.data.result import FrameResult
from stillroom.data.trajectory import read_tum
from stillroom.datasets.open import open_dataset
from stillroom.datasets.selection import Selected, select
from stillroom.errors import ConfigError, FrameError, StillroomError
from stillroom.evaluation.report_file import from_json
from stillroom.evaluation.smoothness import smoothness
from stillroom.evaluation.timing import FRAME
from stillroom.evaluation.trajectory_errors import Alignment, ate
from stillroom.pipeline import RunOptions, RunOutcome, Source, evaluate_folder, run
from stillroom.pipeline.options import detector_ranges
from stillroom.presets.registry import configure, method
from stillroom.protocols import Dataset
from stillroom.semantics.truth import TrueSemanticsConfig
from stillroom.semantics.yolo_fastest import YoloFastestConfig

CONFIG = SlamConfig(semantics=TrueSemanticsConfig())
NOTHING_WRITTEN = RunOptions(root=None)
FILES = {
    "config.toml",
    "frames.csv",
    "groundtruth.tum",
    "keyframes.tum",
    "metrics.json",
    "pictures",
    "report.html",
    "timing.csv",
    "trajectory.tum",
    "trajectory_online.tum",
}


def folder_of(outcome: RunOutcome) -> Path:
    assert outcome.folder is not None
    return outcome.folder


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


class Damaged(Selected):
    """A sequence in which some images cannot be read, and one that raises something worse."""

    def __init__(self, inner: Dataset, unreadable: set[int], fatal: int = -1) -> None:
        super().__init__(inner, np.arange(len(inner)))
        self.unreadable, self.fatal = unreadable, fatal

    def load(self, index: int) -> RgbdImage:
        if index in self.unreadable:
            raise FrameError(f"frame{index}.png: does not decode")
        if index == self.fatal:
            raise RuntimeError("the roof fell in")
        return super().load(index)


class Blind(Selected):
    """A sequence in which one image has no depth."""

    def load(self, index: int) -> RgbdImage:
        image = super().load(index)
        return replace(image, depth_m=np.zeros_like(image.depth_m)) if index == 16 else image


def test_everything_is_written(finished: RunOutcome) -> None:
    folder = folder_of(finished)
    assert {path.name for path in folder.iterdir()} == FILES
    assert folder.name.endswith("_orb-slam2_synthetic_walking_sway_office_45_seed0")
    assert (folder.parent / "latest").resolve() == folder.resolve()


def test_trajectories_are_those_of_the_system(finished: RunOutcome) -> None:
    folder, system = folder_of(finished), finished.system
    for name, trajectory in (
        ("trajectory.tum", system.trajectory()),
        ("trajectory_online.tum", system.online_trajectory()),
        ("keyframes.tum", system.keyframe_trajectory()),
    ):
        written = read_tum(folder / name)
        assert np.allclose(written.timestamps_s, trajectory.timestamps_s, atol=1e-6)
        assert np.allclose(written.T_world_cam, trajectory.T_world_cam, atol=1e-6)
    assert len(read_tum(folder / "trajectory.tum")) == finished.n_tracked == 45


def test_a_method_with_a_trajectory_prior_writes_what_it_knows_five_frames_later(tmp_path: Path) -> None:
    dataset = open_dataset("synthetic:walking,frames=45")
    outcome = run(dataset, configure("orb-slam2", None, ["trajectory.enabled=true"]), RunOptions(root=tmp_path))
    folder, system = folder_of(outcome), outcome.system
    lagged, final = read_tum(folder / "trajectory_lag5.tum"), read_tum(folder / "trajectory.tum")
    assert len(lagged) == len(final) == 45
    assert np.allclose(lagged.T_world_cam, system.lagged_trajectory().T_world_cam, atol=1e-6)

    def jitter_m(name: str) -> float:
        return smoothness(read_tum(folder / name), dataset.groundtruth).jitter_m.rmse

    # Each knows more of the motion than the one before.
    assert jitter_m("trajectory.tum") < jitter_m("trajectory_lag5.tum") < 0.7 * jitter_m("trajectory_online.tum")
    figures = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    for name, file in (("online", "trajectory_online.tum"), ("lagged", "trajectory_lag5.tum")):
        assert figures[name]["jitter_m"] == pytest.approx(jitter_m(file), rel=0.02)
    again = evaluate_folder(folder, write=False).evaluation
    assert again.online is not None
    assert again.lagged is not None
    assert again.lagged.ate_m == pytest.approx(figures["lagged"]["ate_m"], rel=0.02)
    for name in ("trajectory.tum", "trajectory_lag5.tum", "trajectory_online.tum"):
        read_tum(folder / name).scaled(0.7).write_tum(folder / name)
    by_scale = evaluate_folder(folder, write=False, alignment=Alignment.SIM3).evaluation
    assert by_scale.online is not None
    assert by_scale.lagged is not None
    for earlier, file in ((by_scale.online, "trajectory_online.tum"), (by_scale.lagged, "trajectory_lag5.tum")):
        expected = ate(read_tum(folder / file), dataset.groundtruth)
        assert earlier.ate_m == pytest.approx(expected.sim3_m.rmse)
        assert earlier.ate_m < 0.6 * expected.se3_m.rmse


def test_a_last_look_is_better_than_the_first_and_is_counted(tmp_path: Path) -> None:
    dataset = open_dataset("synthetic:empty,frames=45")
    ate_m = {}
    for enabled in ("true", "false"):
        config = configure("orb-slam2", None, [f"last_look.enabled={enabled}"])
        outcome = run(dataset, config, RunOptions(root=tmp_path))
        assert outcome.evaluation is not None
        ate_m[enabled] = outcome.evaluation.as_given.ate_se3_m.rmse
        figures = json.loads((folder_of(outcome) / "metrics.json").read_text(encoding="utf-8"))
        assert figures["run"]["n_looked_again"] == (45 if enabled == "true" else 0)
        assert figures["online"] is None  # without a prior the final poses alone are compared
    assert ate_m["true"] < ate_m["false"]


def test_the_config_makes_the_same_run_again(finished: RunOutcome) -> None:
    file = folder_of(finished) / "config.toml"
    assert updated(SlamConfig(), read_toml(file)) == CONFIG
    assert configure(None, file) == CONFIG
    how = tomllib.loads(file.read_text(encoding="utf-8"))["run"]
    assert how["source"]["sequence"] == "synthetic:walking,frames=45"
    assert how["light"] == "dim"
    assert how["camera_source"]
    assert how["versions"]["numpy"] == np.__version__
    assert set(how["commit"].removesuffix("+changes")) <= set("0123456789abcdef")


def test_every_frame_is_listed(finished: RunOutcome) -> None:
    rows = rows_of(folder_of(finished) / "frames.csv")
    assert [int(row["frame"]) for row in rows] == list(range(45))
    assert {row["state"] for row in rows} == {"ok"}
    assert sum(int(row["is_keyframe"]) for row in rows) >= len(finished.system.map.alive_keyframes())
    assert [int(row["inliers"]) for row in rows] == [result.n_inliers for result in finished.system.results]


def test_every_frame_is_timed(finished: RunOutcome) -> None:
    rows = rows_of(folder_of(finished) / "timing.csv")
    assert [int(row["frame"]) for row in rows] == list(range(45))
    stages = {"loading", "frame", "semantics", "clusters", "features", "tracking", "dynamics", "keyframe", "mapping"}
    stages |= {"flow", "memory", "dense", "carving", "places", "joining", "loops", "rest"}
    assert {name.removesuffix("_wall_ms") for name in rows[0] if name.endswith("_wall_ms")} == stages
    for row in rows:
        parts = sum(float(row[f"{name}_wall_ms"] or 0) for name in ("semantics", "features", "tracking", "mapping"))
        assert 0 < parts <= float(row["frame_wall_ms"])
        assert float(row["dynamics_wall_ms"]) <= float(row["tracking_wall_ms"])
    assert rows[0]["keyframe_wall_ms"]


def test_looking_on_costs_the_frame_nothing(room: Dataset, tmp_path: Path) -> None:
    """Drawing a picture takes longer than a frame, so it would show."""
    pictured = run(select(room, ":8"), CONFIG, RunOptions(folder=tmp_path / "p", pictures=8))
    plain = run(select(room, ":8"), CONFIG, NOTHING_WRITTEN)
    costs = [next(s.cpu_median_ms for s in o.clock.summary() if s.stage == FRAME) for o in (pictured, plain)]
    assert len(list((tmp_path / "p" / "pictures").glob("frame_*.png"))) == 8
    assert costs[0] < 1.5 * costs[1]


def test_figures_are_those_of_the_trajectory(finished: RunOutcome, room: Dataset) -> None:
    text = (folder_of(finished) / "metrics.json").read_text(encoding="utf-8")
    assert from_json(text) == finished.evaluation
    assert finished.evaluation is not None
    assert room.groundtruth is not None
    assert finished.evaluation.as_given.ate_se3_m == ate(finished.system.trajectory(), room.groundtruth).se3_m
    assert finished.evaluation.coverage == 1.0
    own = json.loads(text)["run"]
    assert own["n_keyframes"] == len(finished.system.map.alive_keyframes())
    assert own["static_mean"] == np.mean([result.n_static for result in finished.system.results])
    assert own["frame_ms"]["n_frames"] == 45
    assert own["interrupted"] is False


def test_pictures_are_pictures(finished: RunOutcome) -> None:
    frames = {"frame_00007.png", "frame_00022.png", "frame_00037.png"}
    plots = {"trajectory_above.png", "trajectory_over_time.png", "error.png"}
    assert {path.name for path in finished.pictures} == frames | plots | {"sparse_map.png"}
    for path in finished.pictures:
        picture = cv2.imread(str(path))
        assert picture is not None
        assert picture.std() > 5


def test_evaluating_the_folder_gives_the_same_figures(finished: RunOutcome) -> None:
    folder = folder_of(finished)
    before = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    judged = evaluate_folder(folder.parent / "latest", baseline=folder)
    assert finished.evaluation is not None
    assert judged.evaluation.n_given == 45
    # Files have seven digits.
    assert judged.evaluation.as_given.ate_se3_m.rmse == pytest.approx(
        finished.evaluation.as_given.ate_se3_m.rmse, abs=1e-6
    )
    assert judged.evaluation.improvement is not None
    assert judged.evaluation.improvement.ate_percent == 0.0
    after = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    assert after["run"] == before["run"]
    (folder / "metrics.json").write_text(json.dumps(before), encoding="utf-8")


def test_nothing_is_written_where_nothing_is_to_be(
    room: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = run(select(room, ":8"), CONFIG, NOTHING_WRITTEN)
    assert outcome.folder is None
    assert outcome.evaluation is not None
    assert outcome.pictures == ()
    assert not list(tmp_path.iterdir())


def test_unreadable_images_are_left_out_with_one_warning_each(
    room: Dataset, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    told: list[FrameResult | None] = []

    class Listening:
        def start(self, n_frames: int) -> None:
            assert n_frames == 24

        def frame(self, result: FrameResult | None) -> None:
            told.append(result)

        def finish(self) -> None:
            told.append(None)

    damaged = Damaged(select(room, "2:26"), {14, 17})
    outcome = run(damaged, CONFIG, RunOptions(folder=tmp_path / "out", pictures=0), Listening())
    assert (outcome.n_given, outcome.n_bad, outcome.n_tracked) == (24, 2, 22)
    assert caplog.messages == [
        "image 16 is left out: frame14.png: does not decode",
        "image 19 is left out: frame17.png: does not decode",
    ]
    assert [place for place, result in enumerate(told) if result is None] == [14, 17, 24]
    rows = rows_of(tmp_path / "out" / "frames.csv")
    assert [row["state"] for row in rows] == ["unreadable" if place in (14, 17) else "ok" for place in range(24)]
    assert outcome.evaluation is not None
    assert outcome.evaluation.coverage == 22 / 24
    assert evaluate_folder(tmp_path / "out", write=False).evaluation.coverage == 22 / 24


def test_many_unreadable_images_do_not_flood_the_log(room: Dataset, caplog: pytest.LogCaptureFixture) -> None:
    outcome = run(Damaged(room, set(range(10, 40))), CONFIG, NOTHING_WRITTEN)
    assert outcome.n_bad == 30
    assert sum("left out" in message for message in caplog.messages) == 11


def test_black_and_blind_images_are_remarked_once_and_the_run_goes_on(
    room: Dataset, caplog: pytest.LogCaptureFixture
) -> None:
    dataset = select(Blind(room, np.arange(30)), blackout=["20:23"])
    outcome = run(dataset, CONFIG, NOTHING_WRITTEN)
    assert caplog.messages == [
        "image 16 has no depth anywhere",
        "image 20 is black",
    ]
    assert [r.index for r in outcome.system.results if r.T_world_cam is None] == [20, 21, 22]


def test_without_ground_truth_there_are_no_figures(room: Dataset, tmp_path: Path) -> None:
    class Unknown(Selected):
        groundtruth = None

    outcome = run(Unknown(room, np.arange(6)), CONFIG, RunOptions(folder=tmp_path / "out"))
    assert outcome.evaluation is None
    figures = json.loads((tmp_path / "out" / "metrics.json").read_text(encoding="utf-8"))
    assert (figures["n_tracked"], figures["n_given"], figures["coverage"], figures["as_given"]) == (6, 6, 1.0, None)
    with pytest.raises(StillroomError, match="no ground truth"):
        evaluate_folder(tmp_path / "out")


def test_a_run_without_a_single_pose_is_written_too(
    room: Dataset, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    outcome = run(select(room, ":4", blackout=[":4"]), CONFIG, RunOptions(folder=tmp_path / "out"))
    assert outcome.evaluation is None
    assert outcome.n_tracked == 0
    assert caplog.messages[-1].startswith("no figures: estimate: no poses in it")
    assert {row["state"] for row in rows_of(tmp_path / "out" / "frames.csv")} == {"not initialized"}
    assert (tmp_path / "out" / "trajectory.tum").read_text(encoding="utf-8").count("\n") == 1


def test_a_crash_in_the_middle_keeps_what_there_is(room: Dataset, tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="the roof fell in"):
        run(Damaged(room, set(), fatal=15), CONFIG, RunOptions(folder=tmp_path / "out", pictures=2))
    assert {path.name for path in (tmp_path / "out").iterdir()} == FILES
    assert len(read_tum(tmp_path / "out" / "trajectory.tum")) == 15


def test_ctrl_c_ends_the_run_and_keeps_what_there_is(room: Dataset, tmp_path: Path) -> None:
    before = signal.getsignal(signal.SIGINT)

    class Impatient:
        n = 0

        def start(self, n_frames: int) -> None:
            pass

        def frame(self, result: FrameResult | None) -> None:
            self.n += 1
            if self.n == 9:
                signal.raise_signal(signal.SIGINT)

        def finish(self) -> None:
            pass

    outcome = run(room, CONFIG, RunOptions(folder=tmp_path / "out", pictures=0), Impatient())
    assert outcome.interrupted
    assert outcome.n_given == outcome.n_tracked == 9
    assert len(read_tum(tmp_path / "out" / "trajectory.tum")) == 9
    assert signal.getsignal(signal.SIGINT) is before


def test_wrong_weights_leave_no_folder_behind(room: Dataset, tmp_path: Path) -> None:
    config = replace(CONFIG, semantics=YoloFastestConfig(model=tmp_path / "nowhere.onnx"))
    with pytest.raises(StillroomError, match="no such network"):
        run(room, config, RunOptions(root=tmp_path / "results"))
    assert not list(tmp_path.iterdir())


def test_a_full_disk_is_one_line(room: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from stillroom.data.trajectory import Trajectory

    def full(self: Trajectory, path: Path) -> None:
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(Trajectory, "write_tum", full)
    with pytest.raises(StillroomError, match=r"trajectory\.tum: cannot be written \(No space left on device\)"):
        run(select(room, ":3"), CONFIG, RunOptions(folder=tmp_path / "out"))


def test_the_detector_is_silenced_in_ranges(room: Dataset) -> None:
    seen: list[int] = []

    class Noting:
        def __call__(self, image: RgbdImage) -> object:
            seen.append(image.index)
            return TrueNothing(image)

    def TrueNothing(image: RgbdImage) -> object:
        from stillroom.data.semantics import nothing

        return nothing(image.height, image.width)

    options = RunOptions(root=None, segmenter=Noting(), detector_off=((3, 5),))  # type: ignore[arg-type]
    run(select(room, ":8"), CONFIG, options)
    assert seen == [0, 1, 2, 5, 6, 7]


def test_detector_ranges(room: Dataset) -> None:
    assert detector_ranges(["3:5", ":2", "-4:"], room) == ((3, 5), (0, 2), (41, 45))
    # Numbers are those of the original sequence.
    assert detector_ranges(["30:99"], select(room, "20:40")) == ((30, 45),)
    for wrong in ("5:3", "60:70", "5", "a:b", "1:9:2"):
        with pytest.raises(ConfigError):
            detector_ranges([wrong], room)


@pytest.mark.parametrize("name", ["orb-slam2", "oc-slam"])
def test_images_are_let_go(room: Dataset, name: str) -> None:
    """A long run needs no more memory than its map: nothing holds on to the images of the past."""
    loaded: list[weakref.ref[RgbdImage]] = []
    most = 0

    class Watched(Selected):
        def load(self, index: int) -> RgbdImage:
            nonlocal most
            most = max(most, sum(reference() is not None for reference in loaded))
            image = super().load(index)
            loaded.append(weakref.ref(image))
            return image

    config = replace(method(name).config, semantics=TrueSemanticsConfig())
    run(Watched(room, np.arange(40)), config, NOTHING_WRITTEN)
    assert len(loaded) == 40
    assert most <= 3


def test_a_source_opens_and_selects() -> None:
    source = Source("synthetic:walking,frames=45", frames="10:30", drop=("12:14",), blackout=("20:21",))
    dataset = source.open()
    assert len(dataset) == 18
    assert not dataset.load(8).rgb.any()
