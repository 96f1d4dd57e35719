"""Run a method over a sequence."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

from stillroom.config import SlamConfig
from stillroom.data.image import RgbdImage
from stillroom.data.result import FrameSummary, TrackingState
from stillroom.data.trajectory import Trajectory
from stillroom.datasets.recording import groundtruth_flaw
from stillroom.errors import CameraError, ConfigError, FrameError
from stillroom.pipeline import results
from stillroom.pipeline.evaluating import evaluate_trajectory
from stillroom.pipeline.intake import Intake, intake_of
from stillroom.pipeline.options import RunOptions, RunOutcome
from stillroom.pipeline.ornaments import Ornamental
from stillroom.pipeline.plots import draw_maps, draw_plots
from stillroom.pipeline.stop_request import StopRequest
from stillroom.pipeline.untracked import Seen
from stillroom.protocols import Dataset, RunObserver
from stillroom.semantics.detector import withhold
from stillroom.semantics.mask_files import MaskFilesConfig
from stillroom.session.map_file import MapUse
from stillroom.session.plausibility import doubts_of_figures
from stillroom.session.slam import Slam
from stillroom.system import segmenter_of
from stillroom.viz.masks import MaskWriter
from stillroom.viz.no_observer import NoObserver
from stillroom.viz.recorder import PictureRecorderConfig

log = logging.getLogger(__name__)
MAX_UNREADABLE = 10
LOADING = "loading"


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

    def frame(self, image: RgbdImage, result: FrameSummary) -> None:
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
    if options.map is not None:
        config = options.map.fitting(config)
    intake = intake_of(source)
    origin = intake.origin
    if intake.is_reversed and isinstance(config.semantics, MaskFilesConfig):
        raise ConfigError("--reverse changes the numbers and times by which masks are found; leave one of them out")
    slam = Slam(
        config,
        origin.camera,
        map=None if options.map is None else options.map.path,
        map_use=MapUse.NEW if options.map is None else options.map.use,
        segmenter=withhold(options.segmenter or segmenter_of(config, origin.camera), options.detector_off),
        sequence=origin.name,
    )
    with StopRequest() as stop, slam:
        folder = _folder(origin.name, slam.config, options)
        outcome = RunOutcome(config.method, folder, slam.system, slam.clock, doubts=slam.doubts)
        outcome.map_file, outcome.masks = slam.map_file, options.masks
        outcome.localized_in = None if options.map is None else options.map.read_only
        if folder is not None:
            results.write_config(folder, origin, slam.config, options)
        slam.observe(Ornamental(_recorder(folder, intake, options.pictures), outcome.ornaments))
        if options.masks is not None:
            slam.observe(MaskWriter(options.masks))
        if options.observe is not None:
            slam.observe(options.observe(slam.system))
        with _concluded_in_any_case(outcome, intake, stop, options.pictures > 0), slam:
            progress.start(intake.n_images)
            try:
                _track_all(intake, slam, outcome, stop, progress)
            finally:
                progress.finish()
    return outcome


def _track_all(intake: Intake, slam: Slam, outcome: RunOutcome, stop: StopRequest, progress: RunProgress) -> None:
    remarks = Remarks(outcome.seen)
    with _ended_by_camera(outcome):
        for arrival in intake.arrivals():
            if stop.asked:
                outcome.interrupted = True
                return
            outcome.n_given += 1
            try:
                with slam.clock.stage(LOADING):
                    image = arrival.load()
                result = slam.process(image)
            except FrameError as error:
                outcome.bad.append((arrival.number, arrival.time_s))
                remarks.unreadable(arrival.number, error)
                progress.frame(None)
                continue
            remarks.frame(image, result)
            progress.frame(result)


@contextmanager
def _ended_by_camera(outcome: RunOutcome) -> Iterator[None]:
    """Let a camera that is gone end the run as Ctrl-C does."""
    try:
        yield
    except CameraError as error:
        outcome.interrupted = True
        log.error("%s; the run ends here [see troubleshooting: camera]", error)


@contextmanager
def _concluded_in_any_case(outcome: RunOutcome, intake: Intake, stop: StopRequest, with_plots: bool) -> Iterator[None]:
    """Evaluate and write the results when the block ends, however it ends; signals are then ignored."""
    try:
        yield
        stop.hold()
        outcome.interrupted |= stop.asked
    except KeyboardInterrupt:
        outcome.interrupted = True
    except BaseException:
        stop.hold()
        _conclude(outcome, intake, with_plots)
        raise
    _conclude(outcome, intake, with_plots)
    outcome.interrupted |= stop.asked


def _conclude(outcome: RunOutcome, intake: Intake, with_plots: bool) -> None:
    trajectory, truth, folder = outcome.system.trajectory(), results.Truth.of(intake.origin), outcome.folder
    outcome.has_groundtruth = truth is not None or groundtruth_flaw(intake.origin) != ""
    outcome.n_unpaired = intake.n_unpaired(outcome.n_given)
    cloud = None
    try:
        _evaluate(outcome, trajectory, truth)
    finally:  # what was tracked is written even where memory does not suffice for figures
        if folder is not None:
            cloud = results.write_results(folder, outcome, truth)
    if folder is None:
        return
    title = f"{outcome.method} on {intake.origin.name}"
    n_told, ornaments = outcome.ornaments.n_failed, outcome.ornaments
    if with_plots:
        draw_maps(folder / results.PICTURES, outcome.system, cloud, title, ornaments)
    if with_plots and truth is not None and outcome.evaluation is not None:
        draw_plots(folder / results.PICTURES, {outcome.method: trajectory}, truth.as_given, title, ornaments=ornaments)
    if ornaments.n_failed > n_told:
        with ornaments.drawing():  # the figures are there already, but for this count
            results.write_run_metrics(folder, outcome)
    outcome.pictures = tuple(sorted((folder / results.PICTURES).glob("*.png")))


def _evaluate(outcome: RunOutcome, trajectory: Trajectory, truth: results.Truth | None) -> None:
    outcome.evaluation = evaluate_trajectory(trajectory, truth, outcome.n_recorded)
    if outcome.evaluation is not None:
        for doubt in doubts_of_figures(outcome.evaluation):
            log.warning("%s", doubt)
            outcome.doubts.append(doubt)


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
