"""Runs that keep their map, go on in one, and track against one."""

import hashlib
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from random_map import assert_same_map

from stillroom.config import SlamConfig, read_toml, updated
from stillroom.datasets.open import open_dataset
from stillroom.datasets.recording import DatasetView
from stillroom.datasets.selection import select
from stillroom.dense.dense_mapper import DenseMapperConfig
from stillroom.errors import ConfigError, FrameError, MapError
from stillroom.geometry.depth_noise import UNKNOWN
from stillroom.pipeline import RunOptions, RunOutcome, run
from stillroom.pipeline.options import detector_ranges
from stillroom.protocols import Dataset
from stillroom.semantics.mask_files import MaskFilesConfig
from stillroom.semantics.truth import TrueSemanticsConfig
from stillroom.session.map_file import MapFile, MapUse, dense_cloud
from stillroom.storage import load_map
from stillroom.storage.check import check_map
from stillroom.storage.keeper import MapKeeperConfig
from stillroom.storage.map_export import trajectories
from stillroom.storage.opening import log_of
from stillroom.storage.reader import count_images

CONFIG = SlamConfig(semantics=TrueSemanticsConfig(), storage=MapKeeperConfig(images=True))
# More keyframes than usual: most of these tests are about them.
CONFIG = replace(CONFIG, keyframes=replace(CONFIG.keyframes, share=0.95))


def on(path: Path, use: MapUse) -> RunOptions:
    return RunOptions(root=None, pictures=0, map=MapFile(path, use))


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@dataclass(frozen=True)
class Kept:
    outcome: RunOutcome
    path: Path


@pytest.fixture(scope="module")
def kept(room: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Kept:
    """The first second of the room, with its map."""
    path = tmp_path_factory.mktemp("maps") / "room.stillmap"
    return Kept(run(select(room, frames=":30"), CONFIG, on(path, MapUse.NEW)), path)


@pytest.fixture
def copy(kept: Kept, tmp_path: Path) -> Path:
    path = tmp_path / "room.stillmap"
    path.write_bytes(kept.path.read_bytes())
    return path


def test_the_file_holds_the_map_of_the_run(kept: Kept, room: Dataset) -> None:
    stored, system = load_map(kept.path), kept.outcome.system
    assert kept.outcome.map_file == kept.path
    assert_same_map(stored.world, system.map)
    assert check_map(kept.path) == []
    assert not log_of(kept.path).exists()
    assert room.camera.depth_noise != UNKNOWN, "which a map does not keep: it says nothing of where points are seen"
    assert stored.camera == replace(room.camera, depth_noise=UNKNOWN)
    [session] = stored.sessions
    assert (session.first_keyframe, session.method, session.sequence) == (0, CONFIG.method, room.name)
    assert len(stored.world.alive_keyframes()) > 4


def test_the_config_in_the_file_is_that_of_the_run(kept: Kept, tmp_path: Path) -> None:
    (tmp_path / "config.toml").write_text(load_map(kept.path).sessions[0].config, encoding="utf-8")
    assert updated(SlamConfig(), read_toml(tmp_path / "config.toml")) == CONFIG


def test_the_file_holds_the_trajectory_of_the_run(kept: Kept) -> None:
    [found], expected = trajectories(load_map(kept.path)), kept.outcome.system.trajectory()
    np.testing.assert_array_equal(found.timestamps_s, expected.timestamps_s)
    np.testing.assert_allclose(found.T_world_cam, expected.T_world_cam, atol=1e-12)
    assert len(found) == 30


def test_keeping_a_map_changes_no_pose(kept: Kept, room: Dataset) -> None:
    plain = run(select(room, frames=":30"), CONFIG, RunOptions(root=None, pictures=0))
    np.testing.assert_array_equal(plain.system.trajectory().T_world_cam, kept.outcome.system.trajectory().T_world_cam)


def test_tracking_against_a_map_leaves_it_as_it_is(kept: Kept, room: Dataset) -> None:
    """From a frame in the middle on, through frames that the map has not seen."""
    before, listed = sha256(kept.path), sorted(kept.path.parent.iterdir())
    config = replace(CONFIG, dense=DenseMapperConfig())
    outcome = run(select(room, frames="20:"), config, on(kept.path, MapUse.LOCALIZE))
    assert outcome.n_tracked == 25
    assert not any(result.is_keyframe for result in outcome.system.results)
    assert outcome.system.dense_mapper.cloud() is None
    assert outcome.map_file is None
    assert sha256(kept.path) == before
    assert sorted(kept.path.parent.iterdir()) == listed
    untouched = load_map(kept.path).world
    for name in ("T_world_cam", "is_alive"):
        expected = getattr(untouched.keyframes, name)
        np.testing.assert_array_equal(getattr(outcome.system.map.keyframes, name), expected)
    np.testing.assert_array_equal(outcome.system.map.points.position_m, untouched.points.position_m)
    # The poses are those of the run that made the map, where both saw a frame.
    made = {round(r.timestamp_s, 6): r.T_world_cam for r in kept.outcome.system.results}
    both = [r for r in outcome.system.results if round(r.timestamp_s, 6) in made]
    assert len(both) == 10
    errors_m = [np.linalg.norm(r.T_world_cam[:3, 3] - made[round(r.timestamp_s, 6)][:3, 3]) for r in both]
    assert max(errors_m) < 0.02


def test_tracking_backwards_against_a_map(kept: Kept, room: Dataset) -> None:
    outcome = run(select(room, frames="10:30", reverse=True), CONFIG, on(kept.path, MapUse.LOCALIZE))
    assert outcome.n_tracked == 20
    assert outcome.evaluation is not None
    assert outcome.evaluation.as_given.ate_se3_m.rmse < 0.02


def test_going_on_in_a_map(copy: Path, room: Dataset) -> None:
    """The second run begins somewhere in the map, with times and image numbers of its own."""
    n_before = len(load_map(copy).world.keyframes)
    outcome = run(select(room, frames="15:", reverse=True), CONFIG, on(copy, MapUse.CONTINUE))
    assert outcome.n_tracked == 30
    stored = load_map(copy)
    assert_same_map(stored.world, outcome.system.map)
    assert check_map(copy) == []
    assert [session.first_keyframe for session in stored.sessions] == [0, n_before]
    first, second = trajectories(stored)
    assert (len(first), len(second)) == (30, 30)
    np.testing.assert_allclose(second.T_world_cam, outcome.system.trajectory().T_world_cam, atol=1e-12)
    # Both lie in one world: the same true place has the same pose.
    apart_m = np.linalg.norm(first.positions_m[15:] - second.positions_m[::-1][:15], axis=1)
    assert np.median(apart_m) < 0.02
    keyframes = outcome.system.keyframe_trajectory()
    assert np.all(np.diff(keyframes.timestamps_s) > 0)


def test_going_on_somewhere_else_begins_a_sub_map(copy: Path) -> None:
    elsewhere = open_dataset("synthetic:empty,room=library,seed=3,frames=8")
    config = replace(CONFIG, recovery=replace(CONFIG.recovery, patience=2))
    before = load_map(copy).world
    outcome = run(elsewhere, config, on(copy, MapUse.CONTINUE))
    states = [result.T_world_cam is not None for result in outcome.system.results]
    assert states == [False, False, True, True, True, True, True, True]
    stored = load_map(copy)
    assert check_map(copy) == []
    assert_same_map(stored.world, outcome.system.map)
    n_before = len(before.keyframes)
    assert set(stored.world.keyframes.submap[:n_before]) == {0}
    assert set(stored.world.keyframes.submap[n_before:]) == {1}
    alive = before.keyframes.is_alive
    np.testing.assert_allclose(
        stored.world.keyframes.T_world_cam[:n_before][alive], before.keyframes.T_world_cam[alive], atol=0.01
    )


def test_an_error_in_the_middle_keeps_what_was_committed(room: Dataset, tmp_path: Path) -> None:
    class Failing(DatasetView):
        def load(self, index: int):
            if index == 12:
                raise RuntimeError("the cable came off")
            if index == 5:
                raise FrameError("one bad image")
            return room.load(index)

    path = tmp_path / "room.stillmap"
    with pytest.raises(RuntimeError, match="cable"):
        run(Failing(room), CONFIG, on(path, MapUse.NEW))
    assert check_map(path) == []
    assert len(load_map(path).world.keyframes) >= 2
    assert [file.name for file in tmp_path.iterdir()] == ["room.stillmap"]


def test_a_run_that_never_began_leaves_no_file(room: Dataset, tmp_path: Path) -> None:
    impossible = replace(CONFIG, dense=DenseMapperConfig(voxel_m=0.0))
    with pytest.raises(ConfigError, match="voxel_m"):
        run(room, impossible, on(tmp_path / "room.stillmap", MapUse.NEW))
    assert list(tmp_path.iterdir()) == []


def test_a_dense_map_from_the_images_in_the_file(kept: Kept) -> None:
    stored = load_map(kept.path)
    assert count_images(kept.path) == len(stored.world.keyframes)
    cloud = dense_cloud(kept.path, stored)
    assert len(cloud) > 5000
    # Its points lie where the sparse map has points too.
    from scipy.spatial import cKDTree

    sparse_m = stored.world.points.position_m[stored.world.points.is_alive]
    distance_m, _ = cKDTree(cloud.positions_m).query(sparse_m)
    assert np.median(distance_m) < 0.05


def test_without_images_there_is_no_dense_map(room: Dataset, tmp_path: Path) -> None:
    path = tmp_path / "room.stillmap"
    run(select(room, frames=":2"), replace(CONFIG, storage=MapKeeperConfig()), on(path, MapUse.NEW))
    with pytest.raises(MapError, match=r"keeps no images .* storage.images=true"):
        dense_cloud(path, load_map(path))


def refused(path: Path, use: MapUse, room: Dataset, config: SlamConfig = CONFIG) -> str:
    with pytest.raises(MapError) as caught:
        run(select(room, frames=":2"), config, on(path, use))
    return str(caught.value)


def test_what_does_not_fit_is_refused_untouched(copy: Path, room: Dataset) -> None:
    before = sha256(copy)
    assert "exists already" in refused(copy, MapUse.NEW, room)
    levels = replace(CONFIG, features=replace(CONFIG.features, n_levels=5))
    assert "8 pyramid levels" in refused(copy, MapUse.LOCALIZE, room, levels)
    assert "8 pyramid levels" in refused(copy, MapUse.CONTINUE, room, levels)

    class Other:
        camera = replace(room.camera, fx=500.0)

        def __getattr__(self, name: str) -> object:
            return getattr(room, name)

        def __len__(self) -> int:
            return len(room)

    with pytest.raises(MapError, match=r"another camera .*fx 500"):
        run(Other(), CONFIG, on(copy, MapUse.CONTINUE))
    assert sha256(copy) == before
    assert [file.name for file in copy.parent.iterdir()] == ["room.stillmap"]


def test_a_map_without_keyframes_has_nothing_to_recognise(room: Dataset, tmp_path: Path) -> None:
    path = tmp_path / "room.stillmap"
    dark = select(room, frames=":2", blackout=[":2"])
    run(dark, CONFIG, on(path, MapUse.NEW))
    assert check_map(path) == []
    assert "holds no keyframe" in refused(path, MapUse.LOCALIZE, room)
    assert "holds no keyframe" in refused(path, MapUse.CONTINUE, room)


def test_played_backwards_ranges_are_those_of_the_original(room: Dataset) -> None:
    backwards = select(room, reverse=True)
    [(first, end)] = detector_ranges(["3:5"], backwards)
    chosen = [place for place in range(len(room)) if first <= backwards.load(place).index < end]
    assert [int(len(room) - 1 - place) for place in chosen] == [4, 3]


def test_mask_files_cannot_be_played_backwards(room: Dataset, tmp_path: Path) -> None:
    config = replace(CONFIG, semantics=MaskFilesConfig(folder=tmp_path))
    with pytest.raises(ConfigError, match=r"--reverse .* masks are found"):
        run(select(room, reverse=True), config, RunOptions(root=None, pictures=0))


without_sigkill = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
KILLED = """
import os, signal, sys
from pathlib import Path

import stillroom.session.map_file as use
from stillroom.storage.writer import MapWriter

path, log, statement, step = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
commit, begin, seen, steps = MapWriter.commit, MapWriter.begin, [0], [0]


def die(*_):
    os.kill(os.getpid(), signal.SIGKILL)


def count(sql):
    seen[0] += 1
    if seen[0] == statement:
        die()


def count_steps():
    steps[0] += 1
    if steps[0] == step:
        die()


def counted_begin(self, session):
    self._connection.set_trace_callback(count)
    self._connection.set_progress_handler(count_steps, 10)
    return begin(self, session)


def noted_commit(self, *arguments, **options):
    commit(self, *arguments, **options)
    with open(log, "a") as file:
        file.write(f"{len(self._world.keyframes)}\\n")


MapWriter.begin, MapWriter.commit = counted_begin, noted_commit
sys.path[:0] = sys.argv[5:]
from test_map_runs import CONFIG, on
from stillroom.datasets.open import open_dataset
from stillroom.datasets.selection import select
from stillroom.pipeline import run

room = select(open_dataset("synthetic:walking,frames=45"), frames=":30")
run(room, CONFIG, on(path, use.MapUse.NEW))
print(steps[0])
"""


def attempt(path: Path, statement: int = 0, step: int = 0) -> subprocess.CompletedProcess[str]:
    """Run a process that dies at an SQL statement, or at a step of ten instructions within one; 0: at none."""
    log, here = path.with_suffix(".log"), Path(__file__).parent
    arguments = [str(path), str(log), str(statement), str(step), str(here), str(here.parent / "fabricated")]
    done = subprocess.run([sys.executable, "-c", KILLED, *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == (-9 if statement or step else 0), done.stderr
    return done


def committed_by(path: Path) -> list[int]:
    """Return how many keyframes the process had committed, time after time."""
    log = path.with_suffix(".log")
    return [int(line) for line in log.read_text().split()] if log.exists() else []


def assert_survived(path: Path, committed: list[int], room: Dataset) -> None:
    """The file opens, is whole, holds what was committed; and going on in it finishes the run."""
    assert check_map(path) == []
    stored = load_map(path)
    assert len(stored.world.keyframes) >= max(committed, default=0)
    if len(stored.world.keyframes) == 0:
        path.unlink()
        log_of(path).unlink(missing_ok=True)
        rest, use = select(room, frames=":30"), MapUse.NEW
    else:
        newest = int(stored.world.keyframes.image_index[-1])
        rest, use = select(room, frames=f"{newest + 1 if newest < 29 else 29}:30"), MapUse.CONTINUE
    outcome = run(rest, CONFIG, on(path, use))
    assert outcome.n_tracked == len(rest)
    assert_same_map(load_map(path).world, outcome.system.map)
    assert check_map(path) == []
    assert not log_of(path).exists()


@without_sigkill
@pytest.mark.parametrize("moment", range(3))
def test_a_map_survives_kill_9(moment: int, room: Dataset, tmp_path: Path) -> None:
    """In the middle of a transaction, and between two."""
    statement = int(np.random.default_rng(moment).integers(2 + 20 * moment, 20 + 20 * moment))
    path = tmp_path / "room.stillmap"
    attempt(path, statement)
    assert log_of(path).exists(), "the process ended in peace"
    assert_survived(path, committed_by(path), room)


LIVE = """
import os, signal, sys, threading
from pathlib import Path

import stillroom.session.map_file as use
from stillroom.mapping.local_mapper import LocalMapper
from stillroom.schedule import LiveSchedule

path, keyframe, delay_s = Path(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3])
refine = LocalMapper.refine


def refine_until_killed(self, number):
    if number == keyframe:
        threading.Timer(delay_s, lambda: os.kill(os.getpid(), signal.SIGKILL)).start()
    return refine(self, number)


LocalMapper.refine = refine_until_killed
sys.path[:0] = sys.argv[4:]
from test_map_runs import CONFIG
from stillroom.datasets.open import open_dataset
from stillroom.pipeline import RunOptions, run
from stillroom.session.map_file import MapFile

room = open_dataset("synthetic:walking,frames=45")
options = dict(root=None, pictures=0, map=MapFile(path, use.MapUse.NEW))
while True:  # until the process dies
    run(room, CONFIG, RunOptions(**options, schedule=LiveSchedule(), speed=0.0))
    signal.pause()
"""
LIVE_MOMENTS = [*range(3), *(pytest.param(moment, marks=pytest.mark.slow) for moment in range(3, 20))]


@without_sigkill
@pytest.mark.parametrize("moment", LIVE_MOMENTS)
def test_a_map_survives_kill_9_of_a_live_run(moment: int, room: Dataset, tmp_path: Path) -> None:
    rng = np.random.default_rng(200 + moment)
    path, here = tmp_path / "room.stillmap", Path(__file__).parent
    words = [
        str(path),
        str(rng.integers(0, 6)),
        f"{rng.uniform(0.0, 0.15):.4f}",
        str(here),
        str(here.parent / "fabricated"),
    ]
    done = subprocess.run(
        [sys.executable, "-c", LIVE, *words], capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == -9, done.stderr
    assert_survived(path, [], room)


@pytest.fixture(scope="module")
def n_steps(tmp_path_factory: pytest.TempPathFactory) -> int:
    """How many steps SQLite takes in a whole run."""
    return int(attempt(tmp_path_factory.mktemp("whole") / "room.stillmap").stdout)


@without_sigkill
@pytest.mark.slow
@pytest.mark.parametrize("moment", range(20))
def test_a_map_survives_kill_9_within_any_statement(moment: int, n_steps: int, room: Dataset, tmp_path: Path) -> None:
    step = int(np.random.default_rng(100 + moment).integers(1, n_steps))
    path = tmp_path / "room.stillmap"
    attempt(path, step=step)
    assert_survived(path, committed_by(path), room)
