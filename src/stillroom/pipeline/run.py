"""Run a method over a sequence."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

import numpy as np

from stillroom.config import SlamConfig
from stillroom.data.image import RgbdImage
from stillroom.data.result import FrameSummary, TrackingState
from stillroom.data.trajectory import Trajectory
from stillroom.datasets.recording import groundtruth_flaw, unpaired_s
from stillroom.errors import ConfigError, FrameError
from stillroom.pipeline import results
from stillroom.pipeline.evaluating import evaluate_trajectory
from stillroom.pipeline.options import RunOptions, RunOutcome
from stillroom.pipeline.ornaments import Ornamental
from stillroom.pipeline.plots import draw_maps, draw_plots
from stillroom.pipeline.stop_request import StopRequest
from stillroom.pipeline.untracked import Seen
from stillroom.pipeline.viewing import Viewers, viewed
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

    def start(self, n_frames: int) -> None:
        """Begin a run of `n_frames` frames."""

    def frame(self, result: FrameSummary | None) -> None:
        """Report a frame; None is one that could not be read."""

    def finish(self) -> None:
        """End the run."""


class Silent:
    """Reports nothing."""

    def start(self, n_frames: int) -> None:
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
    dataset: Dataset, config: SlamConfig, options: RunOptions | None = None, progress: RunProgress = SILENT
) -> RunOutcome:
    """Track every image of a sequence, write the results, and evaluate them against the ground truth.

    Ctrl-C, a request to terminate (SIGTERM), a console that is closed (SIGHUP), or an error in the middle ends it
    early; what there is by then is written all the same.

    Args:
        dataset: The sequence.
        config: The method.
        options: What else to do.
        progress: Receives the progress.

    Raises:
        StillroomError: Something that the run needs is wrong; a single image that cannot be read is not.
    """
    options = options or RunOptions()
    if options.map is not None:
        config = options.map.fitting(config)
    if dataset.is_reversed and isinstance(config.semantics, MaskFilesConfig):
        raise ConfigError("--reverse changes the numbers and times by which masks are found; leave one of them out")
    slam = Slam(
        config,
        dataset.camera,
        map=None if options.map is None else options.map.path,
        map_use=MapUse.NEW if options.map is None else options.map.use,
        segmenter=withhold(options.segmenter or segmenter_of(config, dataset.camera), options.detector_off),
        sequence=dataset.name,
    )
    with StopRequest() as stop, slam:
        folder = _folder(dataset, slam.config, options)
        outcome = RunOutcome(config.method, folder, slam.system, slam.clock, doubts=slam.doubts)
        outcome.map_file, outcome.masks = slam.map_file, options.masks
        outcome.localized_in = None if options.map is None else options.map.read_only
        if folder is not None:
            results.write_config(folder, dataset, slam.config, options)
        slam.observe(Ornamental(_recorder(folder, dataset, options.pictures), outcome.ornaments))
        if options.masks is not None:
            slam.observe(MaskWriter(options.masks))
        if options.observe is not None:
            slam.observe(options.observe(slam.system))
        with (
            viewed(slam, dataset, options.viewers, outcome.ornaments) as viewers,
            _concluded_in_any_case(outcome, dataset, stop, options.pictures > 0, viewers),
            slam,
        ):
            progress.start(len(dataset))
            try:
                _track_all(dataset, slam, outcome, stop, progress)
            finally:
                progress.finish()
    return outcome


def _track_all(dataset: Dataset, slam: Slam, outcome: RunOutcome, stop: StopRequest, progress: RunProgress) -> None:
    remarks = Remarks(outcome.seen)
    for place in range(len(dataset)):
        if stop.asked:
            outcome.interrupted = True
            return
        outcome.n_given += 1
        try:
            with slam.clock.stage(LOADING):
                image = dataset.load(place)
            result = slam.process(image)
        except FrameError as error:
            number = int(dataset.numbers[place])
            outcome.bad.append((number, float(dataset.timestamps_s[place])))
            remarks.unreadable(number, error)
            progress.frame(None)
            continue
        remarks.frame(image, result)
        progress.frame(result)


@contextmanager
def _concluded_in_any_case(
    outcome: RunOutcome, dataset: Dataset, stop: StopRequest, with_plots: bool, viewers: Viewers
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
        _conclude(outcome, dataset, with_plots, viewers)
        raise
    _conclude(outcome, dataset, with_plots, viewers)
    outcome.interrupted |= stop.asked


def _conclude(outcome: RunOutcome, dataset: Dataset, with_plots: bool, viewers: Viewers) -> None:
    trajectory, truth, folder = outcome.system.trajectory(), results.Truth.of(dataset), outcome.folder
    outcome.has_groundtruth = truth is not None or groundtruth_flaw(dataset) != ""
    outcome.n_unpaired = _n_unpaired(dataset, outcome.n_given)
    cloud = None
    try:
        _evaluate(outcome, trajectory, truth)
    finally:  # what was tracked is written even where memory does not suffice for figures
        if folder is not None:
            cloud = results.write_results(folder, outcome, truth)
        viewers.conclude(cloud)
    if folder is None:
        return
    title = f"{outcome.method} on {dataset.name}"
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


def _n_unpaired(dataset: Dataset, n_given: int) -> int:
    """Return how many images were left out for want of depth; of a run that was stopped, up to its last image."""
    lost_s = unpaired_s(dataset)
    if n_given < len(dataset):
        lost_s = lost_s[lost_s < dataset.timestamps_s[n_given]]
    return len(lost_s)


def _folder(dataset: Dataset, config: SlamConfig, options: RunOptions) -> Path | None:
    if options.folder is not None:
        return results.chosen_folder(options.folder)
    if options.root is not None:
        return results.new_folder(options.root, config.method, dataset.name)
    return None


def _recorder(folder: Path | None, dataset: Dataset, n_pictures: int) -> RunObserver:
    if folder is None or n_pictures <= 0:
        return NoObserver()
    numbers = dataset.numbers
    # The middles of equal parts: not the first frame, which has no earlier ones, nor the last.
    places = (np.arange(n_pictures) + 0.5) * len(numbers) / n_pictures
    chosen = tuple(int(number) for number in numbers[np.unique(places.astype(np.int64))])
    return PictureRecorderConfig(every=0, frames=chosen).build(folder / results.PICTURES)
