"""Viewers of a run, which are looked at and nothing more: one that fails is left behind, and the run goes on."""

import logging
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager

from stillroom.data.dense_cloud import DenseCloud
from stillroom.data.result import FrameResult, Tracked
from stillroom.data.semantics import Semantics
from stillroom.data.trajectory import Trajectory
from stillroom.errors import StillroomError
from stillroom.pipeline.ornaments import FAILURES, Ornaments
from stillroom.protocols import Origin, Pending, Schedule
from stillroom.schedule import Worker
from stillroom.session.slam import Slam
from stillroom.system import System
from stillroom.viz.viewer.observer import RunViewer, Watched
from stillroom.viz.viewer.recording import Destination

log = logging.getLogger(__name__)


class Viewing:
    """A viewer whose failures do not reach the run: the first is told, and the viewer sees no more."""

    def __init__(self, viewer: RunViewer, ornaments: Ornaments, schedule: Schedule) -> None:
        """Stand between a run and a viewer; frames that it does not show are counted in `ornaments`.

        Under a live schedule a worker of its own shows them, and leaves frames out where it is late.
        """
        self._viewer: RunViewer | None = viewer
        self._schedule = schedule
        self._ornaments = ornaments

    def on_frame(self, tracked: Tracked, semantics: Semantics, result: FrameResult) -> None:
        """Show a frame, or let the worker do it."""
        self._schedule.offer(Worker.VIEWER, self._show, tracked, semantics, result)

    def _show(self, tracked: Tracked, semantics: Semantics, result: FrameResult) -> None:
        with self._left_behind_at(f"image {result.index}"):
            if self._viewer is not None:
                self._viewer.on_frame(tracked, semantics, result)
        if self._viewer is None:
            self._ornaments.n_not_shown += 1

    def conclude(self, cloud: DenseCloud | None) -> None:
        """Show the map as it is in the end."""
        with self._left_behind_at("the end"):
            if self._viewer is not None:
                self._viewer.conclude(cloud)

    def close(self) -> None:
        """Let go of the file or window."""
        with self._left_behind_at("the end"):
            if self._viewer is not None:
                self._viewer.close()

    @contextmanager
    def _left_behind_at(self, moment: str) -> Iterator[None]:
        try:
            yield
        except FAILURES as error:
            viewer, self._viewer = self._viewer, None
            if viewer is not None:
                viewer.abandon()
            log.warning(
                "nothing is shown from %s on, and the run goes on: %s [see troubleshooting: viewer]",
                moment,
                str(error) or type(error).__name__,
            )


class Viewers:
    """All viewers of a run."""

    def __init__(self, viewings: Sequence[Viewing]) -> None:
        """Take them; there may be none."""
        self._viewings = viewings

    def conclude(self, cloud: DenseCloud | None) -> None:
        """Let them show the map as it is in the end."""
        for viewing in self._viewings:
            viewing.conclude(cloud)


@contextmanager
def viewed(slam: Slam, origin: Origin, destinations: Sequence[Destination], ornaments: Ornaments) -> Iterator[Viewers]:
    """Show a run in all destinations, and let go of them in the end.

    Raises:
        MissingExtraError: rerun is not installed.
        StillroomError: A file cannot be written, or the window does not open.
    """
    viewings: list[Viewing] = []
    with ExitStack() as closing:
        for destination in destinations:
            recording = destination.open(f"{slam.config.method} on {origin.name}")
            viewing = Viewing(RunViewer(recording, _watched(slam, origin)), ornaments, slam.system.schedule)
            closing.callback(viewing.close)
            slam.observe(viewing)
            viewings.append(viewing)
        yield Viewers(viewings)


class DenseClouds:
    """The dense map, asked for now and then; its worker makes the cloud, and nobody waits for it."""

    def __init__(self, system: System) -> None:
        """Take the system that makes it."""
        self._system = system
        self._asked: Pending[DenseCloud | None] | None = None

    def __call__(self) -> DenseCloud | None:
        """Return the cloud as it was when it was asked for last, now in order; None while it is being made."""
        if self._asked is None:
            self._asked = self._system.schedule.submit(Worker.DENSE, self._system.dense_mapper.cloud)
        if not self._asked.done():
            return None
        asked, self._asked = self._asked, None
        return asked.result()


def camera_truth(origin: Origin) -> Trajectory | None:
    """Return the true poses of the camera; None where they are not known, or cannot be used."""
    try:
        return origin.groundtruth_at_camera or origin.groundtruth
    except StillroomError:  # the evaluation tells what is wrong with it
        return None


def _watched(slam: Slam, origin: Origin) -> Watched:
    system = slam.system
    return Watched(
        world=system.map,
        trajectory=system.trajectory,
        stages_ms=slam.clock.newest_ms,
        dense=DenseClouds(system),
        truth=camera_truth(origin),
    )
