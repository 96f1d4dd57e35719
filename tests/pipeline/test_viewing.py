"""A run's recording holds what the run knew, read back with rerun's own reader; a viewer that fails ends nothing."""

import logging
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recorded import Recorded

from stillroom.config import SlamConfig
from stillroom.data.result import FrameResult, Tracked
from stillroom.data.semantics import Semantics
from stillroom.datasets.selection import select
from stillroom.dense.dense_mapper import DenseMapperConfig
from stillroom.errors import ConfigError, MissingExtraError, StillroomError
from stillroom.pipeline import RunOptions, RunOutcome, Source, results, run
from stillroom.pipeline.replay import replay
from stillroom.pipeline.run import SILENT
from stillroom.presets.registry import configure
from stillroom.protocols import Dataset
from stillroom.semantics.truth import TrueSemanticsConfig
from stillroom.session.map_file import MapFile
from stillroom.system import System
from stillroom.viz.viewer import entities as at
from stillroom.viz.viewer.observer import RunViewer
from stillroom.viz.viewer.recording import Destination

try:
    import rerun
except ImportError:
    rerun = None  # type: ignore[assignment]

needs_rerun = pytest.mark.skipif(rerun is None, reason="rerun is not installed: pip install 'stillroom[viewer]'")
SOURCE = Source("synthetic:walking,frames=45", frames=":30")
CONFIG = replace(configure("oc-slam"), semantics=TrueSemanticsConfig(), dense=DenseMapperConfig())


class Seen:
    """Keeps what the run told its observers."""

    def __init__(self, system: System) -> None:
        self.system = system
        self.frames: list[tuple[Tracked, Semantics, FrameResult]] = []

    def on_frame(self, tracked: Tracked, semantics: Semantics, result: FrameResult) -> None:
        self.frames.append((tracked, semantics, result))


@pytest.fixture(scope="module")
def seen() -> list[Seen]:
    return []


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory, seen: list[Seen]) -> RunOutcome:
    """A run that is recorded, and kept with its map."""
    folder = tmp_path_factory.mktemp("viewed")

    def observe(system: System) -> Seen:
        seen.append(Seen(system))
        return seen[-1]

    map_file = MapFile(folder / "room.stillmap")
    options = RunOptions(
        folder=folder / "results",
        pictures=0,
        source=SOURCE,
        observe=observe,
        map=map_file,
        asked=dict(map_file.described()),
        viewers=(Destination(folder / "run.rrd"),) if rerun else (),
    )
    return run(SOURCE.open(), CONFIG, options)


def the_folder(outcome: RunOutcome) -> Path:
    assert outcome.folder is not None
    return outcome.folder


@pytest.fixture(scope="module")
def recorded(outcome: RunOutcome) -> Recorded:
    return Recorded(the_folder(outcome).parent / "run.rrd")


@needs_rerun
def test_every_frame_has_its_image_keypoints_boxes_and_clusters(recorded: Recorded, seen: list[Seen]) -> None:
    static = recorded.rows(at.STATIC, "Points2D:positions")
    dynamic = recorded.rows(at.DYNAMIC, "Points2D:positions")
    images = recorded.rows(at.CAMERA_IMAGE, "EncodedImage:blob")
    clusters = recorded.rows(at.CLUSTERS, "SegmentationImage:buffer")
    boxes, labels = recorded.rows(at.BOXES, "Boxes2D:half_sizes"), recorded.rows(at.BOXES, "Boxes2D:labels")
    assert list(images) == list(static) == list(dynamic) == list(clusters) == list(range(30))
    assert sum(len(px) for px in dynamic.values()) > 0, "nothing moved"
    n_boxes = 0
    for tracked, semantics, result in seen[0].frames:
        raw_px, is_static = tracked.frame.keypoints.raw_px, tracked.is_static
        # rerun's pixels begin where ours have their centres less half.
        np.testing.assert_allclose(np.reshape(static[result.index], (-1, 2)), raw_px[is_static] + 0.5, atol=1e-3)
        np.testing.assert_allclose(np.reshape(dynamic[result.index], (-1, 2)), raw_px[~is_static] + 0.5, atol=1e-3)
        if semantics.boxes:
            assert labels[result.index] == [f"{box.label} {box.confidence:.2f}" for box in semantics.boxes]
            edges = np.array([box.xyxy_px for box in semantics.boxes])
            half = 0.5 * (edges[:, 2:] - edges[:, :2])
            np.testing.assert_allclose(boxes[result.index], half, atol=1e-3)
            n_boxes += len(semantics.boxes)
    assert n_boxes > 0


@needs_rerun
def test_masks_and_clusters_are_those_of_the_frame(recorded: Recorded, seen: list[Seen]) -> None:
    clusters = recorded.rows(at.CLUSTERS, "SegmentationImage:buffer")
    masks = recorded.rows(at.MASKS, "SegmentationImage:buffer")
    n_moving = 0
    for _, semantics, result in seen[0].frames:
        assert semantics.clusters is not None
        shown = np.array(clusters[result.index], dtype=np.uint8).reshape(semantics.height, semantics.width)
        assert ((shown == 0) == (semantics.clusters.labels == -1)).all()
        assert ((shown == 1) == (semantics.clusters.labels == -2)).all()
        assert ((shown >= 2) == (semantics.clusters.labels >= 0)).all()
        if result.index in masks:
            mask = np.array(masks[result.index], dtype=np.uint8).reshape(semantics.height, semantics.width)
            assert ((mask == 2) == result.motion.moving).all()
            n_moving += int(result.motion.moving.any())
    assert n_moving > 0


@needs_rerun
def test_camera_path_map_and_graph_are_those_of_the_run(recorded: Recorded, outcome: RunOutcome) -> None:
    system, world = outcome.system, outcome.system.map
    path = recorded.last(at.TRAJECTORY, "LineStrips3D:strips")[0]
    np.testing.assert_allclose(path, system.trajectory().positions_m, atol=1e-4)
    positions = recorded.rows(at.CAMERA, "Transform3D:translation")
    for result in system.results:
        assert result.T_world_cam is not None
        np.testing.assert_allclose(positions[result.index][0], result.T_world_cam[:3, 3], atol=1e-4)
    points = recorded.last(at.POINTS, "Points3D:positions")
    np.testing.assert_allclose(points, world.points.position_m[world.points.is_alive], atol=1e-4)
    frusta = recorded.last(at.KEYFRAMES, "LineStrips3D:strips")
    alive = world.alive_keyframes()
    assert len(frusta) == len(alive) > 1
    np.testing.assert_allclose(frusta[:, 0], world.keyframes.T_world_cam[alive][:, :3, 3], atol=1e-4)
    edges = recorded.last(at.COVISIBILITY, "LineStrips3D:strips")
    ends = world.covisibility.edges()[:, :2]
    np.testing.assert_allclose(edges, world.keyframes.T_world_cam[ends][:, :, :3, 3], atol=1e-4)
    cloud = system.dense_mapper.cloud()
    assert cloud is not None
    np.testing.assert_allclose(recorded.last(at.DENSE, "Points3D:positions"), cloud.positions_m, atol=1e-4)


@needs_rerun
def test_the_ground_truth_lies_along_the_path(recorded: Recorded) -> None:
    path = recorded.last(at.TRAJECTORY, "LineStrips3D:strips")[0]
    truth = recorded.last(at.GROUND_TRUTH, "LineStrips3D:strips")[0]
    assert len(truth) == len(path) == 30
    assert float(np.linalg.norm(truth - path, axis=1).max()) < 0.05
    assert float(np.linalg.norm(path[-1] - path[0])) > 0.0


@needs_rerun
def test_stages_counts_and_state_run_along_both_timelines(recorded: Recorded, outcome: RunOutcome) -> None:
    timing = outcome.clock.summary()
    assert {f"{at.STAGES}/{stage.stage}".replace(" ", "\\ ").replace(":", "\\:") for stage in timing} - {
        f"{at.STAGES}/rest"  # after the last frame
    } <= recorded.entities
    frame_ms = [value[0] for value in recorded.rows(f"{at.STAGES}/frame", "Scalars:scalars").values()]
    assert len(frame_ms) == 30
    assert min(frame_ms) > 0.0
    matches = recorded.rows(f"{at.COUNTS}/matches", "Scalars:scalars")
    assert [value[0] for value in matches.values()] == [result.n_inliers for result in outcome.system.results]
    states = recorded.rows(at.STATE, "StateChange:state")
    assert [value[0] for value in states.values()] == [result.state.value for result in outcome.system.results]
    times = recorded.rows(f"{at.COUNTS}/matches", "Scalars:scalars", timeline="time")
    first_s = outcome.system.results[0].timestamp_s
    np.testing.assert_allclose(
        [time.total_seconds() for time in times], [r.timestamp_s - first_s for r in outcome.system.results], atol=1e-5
    )
    assert recorded.n_blueprints == 2, "one to begin with, and one with the eye that sees the whole room"


@needs_rerun
def test_a_viewer_changes_nothing(outcome: RunOutcome, tmp_path: Path) -> None:
    run(SOURCE.open(), CONFIG, RunOptions(folder=tmp_path / "plain", pictures=0))
    for name in (results.FINAL, results.ONLINE, results.KEYFRAMES):
        assert (tmp_path / "plain" / name).read_bytes() == (the_folder(outcome) / name).read_bytes()


@needs_rerun
def test_a_finished_run_is_replayed(outcome: RunOutcome, tmp_path: Path) -> None:
    shown = replay(the_folder(outcome), Destination(tmp_path / "replay.rrd"), SILENT)
    assert (shown.n_frames, shown.n_images) == (30, 30)
    assert len(shown.missing) == 1
    assert shown.missing[0].startswith("keypoints, boxes, masks and clusters")
    replayed = Recorded(tmp_path / "replay.rrd")
    system, world = outcome.system, outcome.system.map
    positions = replayed.rows(at.CAMERA, "Transform3D:translation")
    np.testing.assert_allclose([p[0] for p in positions.values()], system.trajectory().positions_m, atol=1e-4)
    assert len(replayed.rows(at.CAMERA_IMAGE, "EncodedImage:blob")) == 30
    assert len(replayed.last(at.POINTS, "Points3D:positions")) == int(world.points.is_alive.sum())
    assert len(replayed.last(at.COVISIBILITY, "LineStrips3D:strips")) == len(world.covisibility.edges())
    matches = replayed.rows(f"{at.COUNTS}/matches", "Scalars:scalars")
    assert [value[0] for value in matches.values()] == [result.n_inliers for result in system.results]


@needs_rerun
def test_a_replay_says_what_is_missing(outcome: RunOutcome, tmp_path: Path) -> None:
    folder = tmp_path / "bare"
    folder.mkdir()
    (folder / results.FINAL).write_bytes((the_folder(outcome) / results.FINAL).read_bytes())
    (folder / results.TIMING).write_text("frame,frame_wall_ms\nx,1\n")
    shown = replay(folder, Destination(tmp_path / "bare.rrd"), SILENT)
    assert (shown.n_frames, shown.n_images) == (30, 0)
    told = " ".join(shown.missing)
    for what in ("states and counts", "ground truth", "keyframes", "dense map", "sparse map", "images", "each stage"):
        assert what in told, what
    with pytest.raises(StillroomError, match=r"no trajectory\.tum in it"):
        replay(tmp_path, Destination(tmp_path / "none.rrd"), SILENT)


@needs_rerun
def test_a_viewer_that_fails_is_told_once_and_counted(
    room: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    honest = RunViewer.on_frame

    def failing(self: RunViewer, tracked: Tracked, semantics: Semantics, result: FrameResult) -> None:
        if result.index == 3:
            raise StillroomError("its window was closed")
        honest(self, tracked, semantics, result)

    monkeypatch.setattr(RunViewer, "on_frame", failing)
    options = RunOptions(root=None, pictures=0, viewers=(Destination(tmp_path / "a.rrd"),))
    with caplog.at_level(logging.WARNING):
        outcome = run(select(room, ":8"), SlamConfig(), options)
    assert outcome.n_tracked == 8
    assert outcome.ornaments.n_not_shown == 5
    told = [record.message for record in caplog.records if "nothing is shown" in record.message]
    assert told == [
        "nothing is shown from image 3 on, and the run goes on: its window was closed [see troubleshooting: viewer]"
    ]


FULL = """
import resource, sys
from stillroom.config import SlamConfig
from stillroom.datasets.selection import select
from stillroom.pipeline import RunOptions, Source, run
from stillroom.viz.viewer import recording
from stillroom.viz.viewer.recording import Destination
from pathlib import Path
recording.PATIENCE_WITH_FILE_S = 1.0
resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
room = Source("synthetic:walking,frames=45", frames=":32").open()
outcome = run(room, SlamConfig(), RunOptions(root=None, pictures=0, viewers=(Destination(Path(sys.argv[1])),)))
print(outcome.n_tracked, outcome.ornaments.n_not_shown)
"""


@needs_rerun
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limit for the size of a file")
def test_a_full_disk_ends_nothing(outcome: RunOutcome, tmp_path: Path) -> None:
    """The fixture has compiled the kernels, whose files would be too large as well."""
    ended = subprocess.run(
        [sys.executable, "-c", FULL, str(tmp_path / "full.rrd")], capture_output=True, text=True, timeout=300
    )
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.split() == ["32", "3"], ended.stderr
    assert ended.stderr.count("full.rrd cannot be written on") == 1, ended.stderr
    assert len(ended.stderr.splitlines()) == 1, "rerun adds nothing"


HUNG = """
import socket
from stillroom.config import SlamConfig
from stillroom.pipeline import RunOptions, Source, run
from stillroom.viz.viewer import recording
from stillroom.viz.viewer.recording import Destination, Recording
recording.PATIENCE_S = 0.5
window = socket.socket()  # takes connections, and never answers
window.bind(("127.0.0.1", 0))
window.listen()
url = f"rerun+http://127.0.0.1:{window.getsockname()[1]}/proxy"
Recording._open_window = lambda self: self._stream.connect_grpc(url)
Destination.require_usable = lambda self: None
room = Source("synthetic:walking,frames=45", frames=":32").open()
outcome = run(room, SlamConfig(), RunOptions(root=None, pictures=0, viewers=(Destination(),)))
print(outcome.n_tracked, outcome.ornaments.n_not_shown)
"""


@needs_rerun
def test_a_window_that_hangs_ends_nothing_and_is_not_waited_for(outcome: RunOutcome) -> None:
    ended = subprocess.run([sys.executable, "-c", HUNG], capture_output=True, text=True, timeout=300)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.split() == ["32", "3"], ended.stderr
    assert ended.stderr.count("its window was closed, or does not answer") == 1, ended.stderr
    assert len(ended.stderr.splitlines()) == 1, "rerun adds nothing"


def test_destinations_are_checked_before_anything_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stillroom.viz.viewer.recording.require_rerun", lambda: None)
    with pytest.raises(ConfigError, match=r"let the name end in \.rrd"):
        Destination(tmp_path / "run.mp4").require_usable()
    with pytest.raises(ConfigError, match="name a file in a folder that exists"):
        Destination(tmp_path / "nowhere" / "run.rrd").require_usable()
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    with pytest.raises(ConfigError, match=r"no display .* --rerun FILE\.rrd"):
        Destination().require_usable()


def test_a_missing_rerun_is_named_with_what_installs_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"rerun-sdk is not installed: pip install 'stillroom\[viewer\]'"):
        Destination(tmp_path / "run.rrd").require_usable()
