"""Runs under the live schedule: the same stages as in order, on threads; and every way in which they end."""

import json
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from in_time import PATIENCE_S, soon

from stillroom.config import SlamConfig
from stillroom.data.image import RgbdImage
from stillroom.data.question import Question
from stillroom.data.semantics import Semantics
from stillroom.data.trajectory import read_tum
from stillroom.datasets.selection import select
from stillroom.dense.dense_mapper import DenseMapper, DenseMapperConfig
from stillroom.dynamics.cluster_sieve import ClusterSieveConfig
from stillroom.dynamics.epipolar_sieve import EpipolarSieve
from stillroom.errors import MapError, StillroomError
from stillroom.mapping.local_mapper import LocalMapper
from stillroom.pipeline import RunOptions, RunOutcome, Streamed, run
from stillroom.protocols import Dataset, Pending
from stillroom.schedule import Event, InOrder, LiveSchedule, Worker
from stillroom.semantics.depth_clusters import DepthClusterer, DepthClustersConfig
from stillroom.semantics.masks.carried_masks import LateMasks, MaskCarryConfig
from stillroom.semantics.masks.mask_segments import HalfImage, MaskSegments
from stillroom.semantics.masks.refine import RefineConfig
from stillroom.semantics.masks.regions import RegionsConfig, as_semantics
from stillroom.semantics.truth import TrueMasks, TrueSemanticsConfig
from stillroom.session.map_file import MapFile, MapUse
from stillroom.storage import load_map
from stillroom.storage.check import check_map

CONFIG = SlamConfig(
    semantics=TrueSemanticsConfig(),
    clusters=DepthClustersConfig(),
    dynamics=ClusterSieveConfig(),
    dense=DenseMapperConfig(),
)
MORE_KEYFRAMES = replace(CONFIG, keyframes=replace(CONFIG.keyframes, share=0.95))


@pytest.fixture(autouse=True)
def in_time_and_without_threads() -> Iterator[None]:
    """Fail what hangs, and what leaves a thread."""
    before = set(threading.enumerate())
    yield
    left = [thread.name for thread in threading.enumerate() if thread not in before and thread.name.startswith("still")]
    assert left == []


def live(
    source: Dataset | Streamed,
    config: SlamConfig = CONFIG,
    schedule: LiveSchedule | None = None,
    speed: float = 0.0,
    **more: Any,
) -> RunOutcome:
    """Run on another thread, so that what hangs fails."""
    options = RunOptions(pictures=0, schedule=schedule or LiveSchedule(), speed=speed, **({"root": None} | more))
    return soon(lambda: run(source, config, options))


def test_a_live_run_tracks_all_and_says_what_it_took(room: Dataset, tmp_path: Path) -> None:
    outcome = live(room, folder=tmp_path / "out")
    assert outcome.n_tracked == len(room)
    assert outcome.evaluation is not None
    assert outcome.evaluation.as_given.ate_se3_m.rmse < 0.02
    figures = json.loads((tmp_path / "out" / "metrics.json").read_text(encoding="utf-8"))["run"]["live"]
    assert figures["n_dropped"] == 0
    assert figures["ate_online_m"] < 0.03
    assert figures["n_images_seen_by_network"] == len(room)
    assert figures["workers"]["features"]["n_done"] == len(room)
    assert set(figures["workers"]) == {"semantics", "clusters", "features", "mapping", "dense"}
    assert 0 < figures["due_to_pose_median_ms"] <= figures["due_to_pose_p95_ms"]
    n_keyframes = sum(result.is_keyframe for result in outcome.system.results)
    assert figures["workers"]["mapping"]["n_done"] == 5 * n_keyframes + 1, "every keyframe is refined"
    assert len(read_tum(tmp_path / "out" / "trajectory.tum")) == len(room)


def test_images_that_are_dropped_are_counted_and_named(room: Dataset, tmp_path: Path) -> None:
    outcome = live(room, speed=1e6, folder=tmp_path / "out")
    assert outcome.live is not None
    n_dropped = len(outcome.live.dropped)
    assert n_dropped > 0
    assert outcome.n_given == len(room)
    assert len(outcome.system.results) == len(room) - n_dropped
    table = (tmp_path / "out" / "frames.csv").read_text(encoding="utf-8")
    assert table.count(",dropped,") == n_dropped
    figures = json.loads((tmp_path / "out" / "metrics.json").read_text(encoding="utf-8"))
    assert figures["run"]["live"]["n_dropped"] == n_dropped


def test_both_schedules_have_the_same_stages(room: Dataset) -> None:
    class Noting(InOrder):
        def __init__(self) -> None:
            self.seen: set[tuple[Worker, str]] = set()

        def submit(self, worker: Worker, work: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Any:
            self.seen.add((worker, getattr(work, "__name__", type(work).__name__)))
            return super().submit(worker, work, *args, **kwargs)

        def offer(self, worker: Worker, work: Callable[..., Any], /, *args: Any, **kwargs: Any) -> None:
            self.submit(worker, work, *args, **kwargs)

    in_order, events = Noting(), []
    first = run(room, CONFIG, RunOptions(root=None, pictures=0, schedule=in_order))
    second = live(room, schedule=LiveSchedule(events.append))
    assert {(event.worker, event.work) for event in events if event.what == "begins"} == in_order.seen
    stages = {stage.stage for stage in first.clock.summary()}
    assert stages == {stage.stage for stage in second.clock.summary()}
    errors_m = [np.linalg.norm(a.T_world_cam[:3, 3] - b.T_world_cam[:3, 3]) for a, b in zip(
        first.system.results, second.system.results, strict=True)]  # fmt: skip
    assert max(errors_m) < 0.05


def test_boxes_are_awaited_after_matching_and_clusters_after_the_boxes(
    room: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    """OC-SLAM 2.1 and 2.5. Each worker waits here for what tracking must have done before it waits for the worker."""
    matched = {number: threading.Event() for number in range(len(room))}
    judged = {number: threading.Event() for number in range(len(room))}
    boxes, honest_cluster, honest_judge = TrueSemanticsConfig().build(), DepthClusterer.__call__, EpipolarSieve.judge

    def segment(image: RgbdImage) -> Semantics:
        assert matched[image.index].wait(60.0)
        return boxes(image)

    def cluster(self: DepthClusterer, image: RgbdImage, semantics: Pending[Semantics]) -> Semantics:
        assert judged[image.index].wait(60.0)
        return honest_cluster(self, image, semantics)

    def judge(self: EpipolarSieve, question: Question) -> Any:
        matched[question.frame.image.index].set()
        motion = honest_judge(self, question)
        judged[question.frame.image.index].set()
        return motion

    monkeypatch.setattr(DepthClusterer, "__call__", cluster)
    monkeypatch.setattr(EpipolarSieve, "judge", judge)
    events: list[Event] = []
    outcome = live(room, schedule=LiveSchedule(events.append), segmenter=segment)
    assert outcome.n_tracked == len(room)
    # The log says the same: in no image did dense mapping begin between the wait for clusters and their answer.
    is_waiting = False
    for event in events:
        if event.worker is Worker.CLUSTERS and event.what in ("awaited", "answered"):
            is_waiting = event.what == "awaited"
        assert not (is_waiting and event.worker is Worker.DENSE and event.what == "begins")
    assert sum(event.what == "awaited" and event.worker is Worker.CLUSTERS for event in events) >= len(room) // 2


@pytest.mark.parametrize(
    ("owner", "name"), [(LocalMapper, "refine"), (DenseMapper, "integrate"), (DepthClusterer, "__call__")]
)
def test_a_worker_that_raises_ends_the_run_with_its_message_and_what_is_done(
    owner: type, name: str, room: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    honest, calls = getattr(owner, name), []

    def breaks(self: Any, *args: Any) -> Any:
        calls.append(name)
        # Clusters are begun some images ahead of tracking, which must have tracked one.
        if len(calls) == (9 if owner is DepthClusterer else 3):
            raise MapError("the worker broke")
        return honest(self, *args)

    monkeypatch.setattr(owner, name, breaks)
    with pytest.raises(MapError, match="the worker broke"):
        live(room, MORE_KEYFRAMES, folder=tmp_path / "out")
    assert len(read_tum(tmp_path / "out" / "trajectory_online.tum")) >= 1
    assert (tmp_path / "out" / "metrics.json").exists()


def test_a_network_that_takes_five_seconds_holds_nobody_up(room: Dataset) -> None:
    """Its first result is waited for; later ones come when they come, and masks are propagated until then."""
    truth, schedule, seen, ages = TrueMasks(), LiveSchedule(), [], []

    def see(image: RgbdImage, view: HalfImage) -> MaskSegments:
        seen.append(image.index)
        if len(seen) == 2:
            time.sleep(5.0)
        label = truth(image).movable[::2, ::2].astype(np.uint8)
        return MaskSegments(label, label.astype(np.float32))

    masks = LateMasks(see, 1, 0, MaskCarryConfig(), RefineConfig(), schedule)

    def segment(image: RgbdImage) -> Semantics:
        known = masks(image)
        ages.append(known.age)
        return as_semantics(known.segments, ("person",), image.height, image.width, known.age, RegionsConfig(), ())

    outcome = live(room, schedule=schedule, segmenter=segment)
    assert outcome.n_tracked == len(room)
    assert outcome.live is not None
    assert outcome.live.n_seen == len(seen) < len(room)
    assert ages[0] == 0
    assert max(ages) >= 5
    assert outcome.evaluation is not None
    assert outcome.evaluation.as_given.ate_se3_m.rmse < 0.03


def test_masks_that_come_late_are_those_of_the_present(room: Dataset) -> None:
    """A mask of an image before is carried through the images since, as in order with the same delay."""
    gate, end, truth = threading.Event(), threading.Event(), TrueMasks()

    def see(image: RgbdImage, view: HalfImage) -> MaskSegments:
        if image.index == 1:
            assert gate.wait(60.0)
        if image.index == gate_opened_at:
            assert end.wait(60.0)
        label = truth(image).movable[::2, ::2].astype(np.uint8)
        return MaskSegments(label, label.astype(np.float32))

    gate_opened_at, schedule = 4, LiveSchedule()
    late = LateMasks(see, 1, 0, MaskCarryConfig(), RefineConfig(), schedule)
    in_order = LateMasks(see, 5, 0, MaskCarryConfig(), RefineConfig())
    for k in range(gate_opened_at):
        late(room.load(k))
    gate.set()
    while not late._waiting[0].segments.done():
        pass
    now = late(room.load(gate_opened_at))
    end.set()
    schedule.close()
    for k in range(1, gate_opened_at + 1):  # the network sees image 1 alone
        expected = in_order(room.load(k))
    assert now.age == expected.age == gate_opened_at - 1
    np.testing.assert_array_equal(now.segments.label, expected.segments.label)


class Faulty:
    """A camera that skips, repeats, turns back, and is pulled out in the end."""

    groundtruth = groundtruth_at_camera = None
    comes_in_time = False
    name, camera_source = "faulty", "the room"

    def __init__(self, room: Dataset, numbers: list[int]) -> None:
        self.camera, self._room, self._numbers = room.camera, room, iter(numbers)

    def __enter__(self) -> "Faulty":
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def next(self) -> RgbdImage | None:
        number = next(self._numbers, None)
        if number is None:
            raise StillroomError("the cable is out")
        return self._room.load(number)


def test_a_camera_that_skips_repeats_turns_back_and_dies(room: Dataset, tmp_path: Path) -> None:
    with pytest.raises(StillroomError, match="the cable is out"):
        live(Streamed(Faulty(room, [0, 1, 2, 2, 5, 4, 6, 7, 8])), folder=tmp_path / "out")
    written = read_tum(tmp_path / "out" / "trajectory.tum")
    np.testing.assert_allclose(written.timestamps_s, [room.timestamps_s[k] for k in (0, 1, 2, 5, 6, 7, 8)], atol=1e-6)
    table = (tmp_path / "out" / "frames.csv").read_text(encoding="utf-8")
    assert table.count(",unreadable,") == 2


def test_the_map_of_a_live_run_is_whole_and_can_be_tracked_against(room: Dataset, tmp_path: Path) -> None:
    path = tmp_path / "room.stillmap"
    outcome = live(room, MORE_KEYFRAMES, map=MapFile(path, MapUse.NEW))
    assert check_map(path) == []
    stored = load_map(path).world
    np.testing.assert_array_equal(stored.keyframes.is_alive, outcome.system.map.keyframes.is_alive)
    again = run(select(room, ":10"), MORE_KEYFRAMES, RunOptions(root=None, map=MapFile(path, MapUse.LOCALIZE)))
    assert again.n_tracked == 10


def test_two_systems_live_at_a_time(room: Dataset) -> None:
    outcomes: list[RunOutcome] = []
    threads = [
        threading.Thread(target=lambda: outcomes.append(live(select(room, ":20"))), daemon=True) for _ in range(2)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE_S)
    assert [outcome.n_tracked for outcome in outcomes] == [20, 20]
