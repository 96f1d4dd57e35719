"""Run a method over a sequence."""

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Protocol

from stillroom.config import SlamConfig
from stillroom.data.image import Image
from stillroom.data.replacing import replace_text
from stillroom.data.result import FrameSummary, TrackingState
from stillroom.data.trajectory import Trajectory
from stillroom.datasets.recording import groundtruth_flaw, sensor_of
from stillroom.errors import CameraError, ConfigError, FrameError
from stillroom.pipeline import results
from stillroom.pipeline.evaluating import evaluate_trajectory
from stillroom.pipeline.intake import Intake, intake_of
from stillroom.pipeline.live import LiveFigures
from stillroom.pipeline.options import RunOptions, RunOutcome
from stillroom.pipeline.ornaments import Ornamental, ending_nothing
from stillroom.pipeline.playback import InTurn, Paced, Playback
from stillroom.pipeline.plots import draw_maps, draw_plots
from stillroom.pipeline.reports.run_page import write_run_page
from stillroom.pipeline.stop_request import StopRequest
from stillroom.pipeline.untracked import Seen
from stillroom.pipeline.viewing import Viewers, viewed
from stillroom.pipeline.warned import kept_warnings
from stillroom.protocols import Dataset, Origin, RunObserver, Segmenter
from stillroom.schedule import LiveSchedule, Worker
from stillroom.semantics.detector import withhold
from stillroom.semantics.mask_files import MaskFilesConfig
from stillroom.semantics.no_segmenter import NothingConfig
from stillroom.session.map_file import MapUse
from stillroom.session.plausibility import doubts_of_figures
from stillroom.session.slam import Slam
from stillroom.system import segmenter_of
from stillroom.viz.masks import MaskWriter
from stillroom.viz.no_observer import NoObserver
from stillroom.viz.recorder import PictureRecorderConfig

log = logging.getLogger(__name__)
MAX_UNREADABLE = 10


# Progress of a run, and its log.


class RunProgress(Protocol):
    """Receives the progress of a run, such as a progress bar."""

    def start(self, n_frames: int | None) -> None:
        """Begin a run of `n_frames` frames; None where a camera delivers them until it is stopped."""

    def frame(self, result: FrameSummary | None) -> None:
        """Report a frame; None is one that could not be read."""

    def finish(self) -> None:
        """End the run."""


class Silent:
    """Reports nothing."""

    def start(self, n_frames: int | None) -> None:
        """Do nothing."""

    def frame(self, result: FrameSummary | None) -> None:
        """Do nothing."""

    def finish(self) -> None:
        """Do nothing."""


SILENT = Silent()


class Remarks:
    """Logs anomalies of a run: one line when an anomaly begins, not one for every frame."""

    def __init__(self, seen: Seen) -> None:
        """Begin; what the images are like is counted in `seen`."""
        self._seen = seen
        self._n_unreadable = 0
        self._odd: dict[str, bool] = {}

    def unreadable(self, number: int, error: FrameError) -> None:
        """Remark that an image cannot be read."""
        self._n_unreadable += 1
        if self._n_unreadable <= MAX_UNREADABLE:
            log.warning("image %d is left out: %s", number, error)
        if self._n_unreadable == MAX_UNREADABLE:
            log.warning("further images that cannot be read are left out silently")

    def frame(self, image: Image, result: FrameSummary) -> None:
        """Log anomalies of an image, and where tracking is lost and resumes."""
        is_black, no_depth = self._seen.add(image)
        self._begins("black", is_black, "image %d is black", image.index)
        self._begins("no depth", no_depth, "image %d has no depth anywhere", image.index)
        # A black image explains the missing pose.
        was_lost = self._odd.get("lost", False)
        is_lost = result.state is TrackingState.LOST and (was_lost or not is_black)
        self._begins("lost", is_lost, "tracking is lost at image %d", image.index)
        if was_lost and not is_lost:
            log.warning("tracking resumes at image %d", image.index)

    def _begins(self, what: str, is_so: bool, message: str, number: int) -> None:
        if is_so and not self._odd.get(what, False):
            log.warning(message, number)
        self._odd[what] = is_so


def run(
    source: Dataset | Intake, config: SlamConfig, options: RunOptions | None = None, progress: RunProgress = SILENT
) -> RunOutcome:
    """Track every image of a sequence or of a camera, write the results, and evaluate them against the ground truth.

    Ctrl-C, a request to terminate (SIGTERM), a console that is closed (SIGHUP), a camera that is gone, or an error in
    the middle ends it early; what there is by then is written all the same.

    Args:
        source: The sequence; or `Streamed(camera)`, the images of a camera that is entered.
        config: The method.
        options: What else to do.
        progress: Receives the progress.

    Raises:
        StillroomError: Something that the run needs is wrong; a single image that cannot be read is not.
    """
    options = options or RunOptions()
    warnings = list(options.warned)
    with kept_warnings(warnings):
        return _run(intake_of(source), config, options, progress, warnings)


def _run(
    intake: Intake, config: SlamConfig, options: RunOptions, progress: RunProgress, warnings: list[str]
) -> RunOutcome:
    if options.map is not None:
        config = options.map.fitting(config)
    origin = intake.origin
    if intake.is_reversed and isinstance(config.semantics, MaskFilesConfig):
        raise ConfigError("--reverse changes the numbers and times by which masks are found; leave one of them out")
    slam = Slam(
        config,
        origin.camera,
        map=None if options.map is None else options.map.path,
        map_use=MapUse.NEW if options.map is None else options.map.use,
        segmenter=withhold(_segmenter(config, origin, options), options.detector_off),
        schedule=options.schedule,
        sensor=sensor_of(origin),
        sequence=origin.name,
    )
    with StopRequest() as stop, slam:
        folder = _folder(origin.name, slam.config, options)
        outcome = RunOutcome(config.method, folder, slam.system, slam.clock, doubts=slam.doubts, warnings=warnings)
        outcome.sensor, outcome.left_out = slam.sensor, slam.left_out
        outcome.map_file, outcome.masks = slam.map_file, options.masks
        outcome.localized_in = None if options.map is None else options.map.earlier
        if folder is not None:
            results.write_config(folder, origin, slam.config, options)
        slam.observe(Ornamental(_recorder(folder, intake, options.pictures), outcome.ornaments))
        if options.masks is not None:
            slam.observe(MaskWriter(options.masks))
        if options.observe is not None:
            slam.observe(options.observe(slam.system))
        with (
            viewed(slam, origin, options.viewers, outcome.ornaments) as viewers,
            _concluded_in_any_case(outcome, intake, stop, options, viewers),
            _until_idle(outcome),
            slam,
        ):
            progress.start(intake.n_images)
            try:
                with _playback(intake, slam, outcome, options) as playback:
                    _track_all(playback, slam, outcome, stop, progress)
            finally:
                progress.finish()
    return outcome


def _segmenter(config: SlamConfig, origin: Origin, options: RunOptions) -> Segmenter:
    return options.segmenter or segmenter_of(config, origin.camera, options.schedule, sensor_of(origin))


def _playback(intake: Intake, slam: Slam, outcome: RunOutcome, options: RunOptions) -> Playback:
    """Return what delivers the images; under a live schedule begin to count what it takes."""
    if not isinstance(options.schedule, LiveSchedule):
        return InTurn(intake, slam.clock)
    catch_up = partial(options.schedule.catch_up, Worker.MAPPING)
    paced = Paced(intake, slam.clock, options.speed, catch_up)
    has_segmenter = not isinstance(slam.config.semantics, NothingConfig)
    outcome.live = LiveFigures(options.speed, options.schedule, paced.dropped, has_segmenter)
    return paced


def _track_all(playback: Playback, slam: Slam, outcome: RunOutcome, stop: StopRequest, progress: RunProgress) -> None:
    remarks = Remarks(outcome.seen)
    n_dropped = 0
    with _ended_by_camera(outcome):
        for delivered in playback.images(lambda: stop.asked):
            while n_dropped < len(playback.dropped):
                n_dropped += 1
                outcome.n_given += 1
                progress.frame(None)
            outcome.n_given += 1
            arrival, image = delivered.arrival, delivered.image
            try:
                if isinstance(image, FrameError):
                    raise image
                result = slam.process(image, playback.following())
            except FrameError as error:
                outcome.bad.append((arrival.number, arrival.time_s))
                remarks.unreadable(arrival.number, error)
                progress.frame(None)
                continue
            if outcome.live is not None:
                outcome.live.delays_s.append(time.perf_counter() - delivered.due_s)
            remarks.frame(image, result)
            progress.frame(result)
        outcome.interrupted |= stop.asked


@contextmanager
def _until_idle(outcome: RunOutcome) -> Iterator[None]:
    """Take the time of the block: a system is closed in it when all workers are done."""
    start_s = time.perf_counter()
    try:
        yield
    finally:
        if outcome.live is not None:
            outcome.live.wall_s = time.perf_counter() - start_s


@contextmanager
def _ended_by_camera(outcome: RunOutcome) -> Iterator[None]:
    """Let a camera that is gone end the run as Ctrl-C does."""
    try:
        yield
    except CameraError as error:
        outcome.interrupted = True
        log.error("%s; the run ends here [see troubleshooting: camera]", error)


@contextmanager
def _concluded_in_any_case(
    outcome: RunOutcome, intake: Intake, stop: StopRequest, options: RunOptions, viewers: Viewers
) -> Iterator[None]:
    """Evaluate and write the results when the block ends, however it ends; signals are then ignored."""
    try:
        yield
        stop.hold()
        outcome.interrupted |= stop.asked
    except KeyboardInterrupt:
        outcome.interrupted = True
    except BaseException:
        stop.hold()
        _conclude(outcome, intake, options, viewers)
        raise
    _conclude(outcome, intake, options, viewers)
    outcome.interrupted |= stop.asked


def _conclude(outcome: RunOutcome, intake: Intake, options: RunOptions, viewers: Viewers) -> None:
    trajectory, truth, folder = outcome.system.trajectory(), results.Truth.of(intake.origin), outcome.folder
    outcome.has_groundtruth = truth is not None or groundtruth_flaw(intake.origin) != ""
    outcome.n_unpaired = intake.n_unpaired(outcome.n_given)
    cloud = None
    try:
        _evaluate(outcome, trajectory, truth)
    finally:  # what was tracked is written even where memory does not suffice for figures
        if folder is not None:
            cloud = results.write_results(folder, outcome, truth)
        viewers.conclude(cloud)
    if folder is None:
        return
    pictures, title = folder / results.PICTURES, f"{outcome.method} on {intake.origin.name}"
    n_told, ornaments = outcome.ornaments.n_failed, outcome.ornaments
    if options.pictures > 0:
        draw_maps(pictures, outcome.system, cloud, title, ornaments, options.formats)
        if truth is not None and outcome.evaluation is not None:
            estimates = {outcome.method: trajectory}
            draw_plots(pictures, estimates, truth.as_given, title, ornaments=ornaments, formats=options.formats)
    if ornaments.n_failed > n_told:
        with ornaments.drawing():  # the figures are there already, but for this count
            results.write_run_metrics(folder, outcome)
    outcome.pictures = tuple(sorted(pictures.glob("*.png")))
    if options.report:
        _write_report(outcome, folder)


def _write_report(outcome: RunOutcome, folder: Path) -> None:
    """Write the report of what is there; that it cannot be written is a warning."""
    with ending_nothing("the report is left out"):
        if outcome.warnings:
            replace_text(folder / results.WARNINGS, "".join(f"{warning}\n" for warning in outcome.warnings))
        outcome.report = write_run_page(folder)


def _evaluate(outcome: RunOutcome, trajectory: Trajectory, truth: results.Truth | None) -> None:
    lagged = outcome.system.lagged_trajectory()
    online = None if lagged is None else outcome.system.online_trajectory()
    outcome.evaluation = evaluate_trajectory(trajectory, truth, outcome.n_recorded, online, lagged)
    if outcome.evaluation is not None:
        for doubt in doubts_of_figures(outcome.evaluation):
            log.warning("%s", doubt)
            outcome.doubts.append(doubt)
    if outcome.live is not None:  # in order the two differ by what mapping corrected later, and only the final is given
        outcome.live.online = evaluate_trajectory(outcome.system.online_trajectory(), truth, outcome.n_recorded)


def _folder(name: str, config: SlamConfig, options: RunOptions) -> Path | None:
    if options.folder is not None:
        return results.chosen_folder(options.folder)
    if options.root is not None:
        return results.new_folder(options.root, config.method, name)
    return None


def _recorder(folder: Path | None, intake: Intake, n_pictures: int) -> RunObserver:
    if folder is None or n_pictures <= 0:
        return NoObserver()
    return PictureRecorderConfig(every=0, frames=intake.spread(n_pictures)).build(folder / results.PICTURES)
