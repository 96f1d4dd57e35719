"""The verdict that rows are read as one, while workers map: tracking must not wait for what waits for it."""

from dataclasses import replace

from in_time import soon

from stillroom.datasets.open import open_dataset
from stillroom.presets.registry import configure
from stillroom.schedule import Worker
from stillroom.session.slam import Slam


def test_a_live_run_goes_on_while_a_correction_of_the_map_waits_for_the_frame_of_the_verdict() -> None:
    room = open_dataset("synthetic:empty,path=rpy,frames=40")
    slam = Slam(
        configure("orb-slam2", None, ("tracking.shutter=rolling",)),
        replace(room.camera, readout_s=0.03),
        schedule="live",
    )
    tracker, put_back = slam.system.tracker, list[int]()
    as_is = tracker.put_back

    def correct() -> None:
        with slam.map.lock.between_frames():
            pass

    def behind_a_correction() -> list[int]:
        keyframes = as_is()
        if keyframes:
            slam.system.schedule.submit(Worker.MAPPING, correct)
            put_back.extend(keyframes)
        return keyframes

    tracker.put_back = behind_a_correction  # type: ignore[method-assign]

    def track() -> None:
        with slam:
            for k in range(len(room)):
                slam.process(room.load(k))

    soon(track)
    assert put_back
    assert tracker.rows is not None
    assert tracker.rows.as_one
    assert not tracker.found_again(slam.map), "frames until the verdict were found again, at the end at the latest"
    assert len(slam.trajectory()) == len(room)
