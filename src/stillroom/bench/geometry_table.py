"""PSPNet-SLAM's Table 2, in one run: every point tested, and the points along a path, on the same points."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from stillroom.bench.observers import TESTS, GeometryObserver, GeometryTrialConfig, Shown
from stillroom.bench.trial import all_keypoints, poses_only
from stillroom.config import SlamConfig
from stillroom.dynamics.ants.comparison import SearchComparison, total
from stillroom.dynamics.homography.point_motion import DYNAMIC, UNKNOWN
from stillroom.errors import StillroomError
from stillroom.evaluation.report import percent
from stillroom.geometry.arrays import U8
from stillroom.geometry.camera import Camera
from stillroom.pipeline import SILENT, RunOptions, RunProgress, run
from stillroom.protocols import Dataset
from stillroom.system import System
from stillroom.viz.film import contact_sheet
from stillroom.viz.geometry_pictures import AntWalk, compensated, draw_ant_walk, draw_difference, draw_moving_points
from stillroom.viz.png import write_png

HEADER = ("point test", "search", "tested", "recall", "precision", "path px", "ms", "ratio", "with regions", "ratio")
"""Names of the columns of `GeometryTable.rows`; times are of CPU, milliseconds an image."""
PAPER_RATIO = "0.67–0.87"
EVERY = "every point"
SCALE = 1.5


@dataclass(frozen=True)
class GeometryTable:
    """The results of the searches on a sequence.

    Attributes:
        sequence: Its name.
        sums: Over all compared images, by test and search.
        shown: An image to draw; None where there was none.
    """

    sequence: str
    sums: dict[tuple[str, str], SearchComparison]
    shown: Shown | None

    def rows(self) -> list[tuple[str, ...]]:
        """Return the cells under `HEADER`: of each test, every point and then the searches."""
        rows = []
        for test in TESTS:
            searches = {search: one for (of, search), one in self.sums.items() if of == test}
            for search, one in searches.items():
                if search == next(iter(searches)):
                    rows.append(_row(test, EVERY, _as_exhaustive(one)))
                rows.append(_row("", search, one))
        return rows

    def sentences(self) -> list[str]:
        """Return notes on how to read the rows."""
        lines = []
        for test in TESTS:
            one = next((one for (of, _), one in self.sums.items() if of == test), None)
            if one is not None:
                lines.append(
                    f"{test}: {one.n_points / one.n_images:.0f} points an image, of which the exhaustive test finds "
                    f"{one.n_dynamic / one.n_images:.0f} to move; {one.test_s * 1e6:.2f} µs a point, all ways through "
                    "the same kernel"
                )
                lines += [self._verdict(test, search) for (of, search) in self.sums if of == test]
        n_images = max((one.n_images for one in self.sums.values()), default=0)
        return [
            f"{n_images} images, CPU time of one thread, the fastest of a few tries of each; a search's time holds its "
            f"path, its memory and its tests. The paper's ratio, regions included, is {PAPER_RATIO}",
            *lines,
        ]

    def _verdict(self, test: str, search: str) -> str:
        """Return in a sentence whether a search saves time."""
        one = self.sums[test, search]
        spared_ms = (one.n_points - one.n_tested) / one.n_images * one.test_s * 1e3
        own_ms = one.search_s / one.n_images * 1e3 - one.n_tested / one.n_images * one.test_s * 1e3
        saves = "saves" if one.time_ratio < 1 else "does not save"
        return (
            f"{test}, {search}: {saves} time: the tests that it spares cost {spared_ms:.2f} ms an image, finding out "
            f"which they are {own_ms:.2f} ms"
        )

    def to_dict(self) -> list[dict[str, Any]]:
        """Return the figures for a JSON file."""
        return [
            {"sequence": self.sequence, "test": test, "search": search}
            | asdict(one)
            | {name: getattr(one, name) for name in ("share_tested", "recall", "precision", "time_ratio", "test_s")}
            | {"time_ratio_with_growing": one.time_ratio_with_growing}
            for (test, search), one in self.sums.items()
        ]


def geometry_table(
    dataset: Dataset, config: SlamConfig, trial: GeometryTrialConfig, progress: RunProgress = SILENT
) -> GeometryTable:
    """Track a sequence, and run both geometries on its images. Kernels should be compiled.

    Args:
        dataset: The sequence.
        config: The method that tracks the camera.
        trial: What is measured on each image.
        progress: Called for each frame.

    Raises:
        KeyboardInterrupt: The user stopped it.
        StillroomError: Something that the run needs is wrong, or no image could be compared.
    """
    made: list[GeometryObserver] = []

    def observe(system: System) -> GeometryObserver:
        made.append(trial.build(system, config.seed))
        return made[0]

    options = RunOptions(root=None, pictures=0, observe=observe)
    outcome = run(dataset, all_keypoints(poses_only(config)), options, progress)
    if outcome.interrupted:
        raise KeyboardInterrupt
    sums = {which: total(parts) for which, parts in made[0].comparisons.items()}
    if not sums:
        raise StillroomError(
            f"{dataset.name}: no image could be compared with an earlier one; choose a longer stretch with --frames"
        )
    return GeometryTable(dataset.name, sums, made[0].shown)


def _as_exhaustive(one: SearchComparison) -> SearchComparison:
    return replace(
        one,
        n_tested=one.n_points,
        n_found=one.n_dynamic,
        n_wrong=0,
        path_length_px=0.0,
        search_s=one.exhaustive_s,
        growing_s=one.exhaustive_growing_s,
    )


def _row(test: str, search: str, one: SearchComparison) -> tuple[str, ...]:
    def ms(seconds: float) -> str:
        return f"{seconds / one.n_images * 1e3:.2f}"

    return (
        test,
        search,
        percent(one.share_tested),
        percent(one.recall),
        percent(one.precision),
        f"{one.path_length_px / one.n_images:.0f}",
        ms(one.search_s),
        f"{one.time_ratio:.2f}",
        ms(one.search_s + one.growing_s),
        f"{one.time_ratio_with_growing:.2f}",
    )


# Four panels of one image: its difference from an earlier one, plain and compensated, what moves, the ants' path.


def write_geometry_picture(path: Path, shown: Shown, camera: Camera) -> None:
    """Write PSPNet-SLAM's Figures 5 and 6 of a real image as a PNG.

    Args:
        path: The file.
        shown: The image and what was found in it.
        camera: The calibration.

    Raises:
        StillroomError: The file cannot be written.
    """
    age_ms = (shown.image.timestamp_s - shown.earlier.timestamp_s) * 1e3
    moved, seen = compensated(shown.earlier.gray, shown.findings.test.H_then_now, camera)
    panels = (
        (f"difference from the image {age_ms:.0f} ms before", draw_difference(shown.image.gray, shown.earlier.gray)),
        ("the same, compensated by the homography", draw_difference(shown.image.gray, moved, seen)),
        ("every point tested", _points(shown)),
        (f"along the ants' path: {100 * shown.found.share_tested:.0f} % tested", _walk(shown)),
    )
    width = round(SCALE * camera.width)
    write_png(path, contact_sheet([(label, (picture,)) for label, picture in panels], width, per_row=2))


def _points(shown: Shown) -> U8:
    test, verdicts = shown.findings.test, shown.findings.verdicts
    return draw_moving_points(shown.image.rgb, test.raw_px, verdicts == DYNAMIC, verdicts != UNKNOWN, SCALE)


def _walk(shown: Shown) -> U8:
    found = shown.found
    walk = AntWalk(
        points_px=shown.findings.test.raw_px,
        is_tested=np.asarray(found.is_tested),
        moves=np.asarray(found.is_dynamic),
        path_px=found.path_px,
        radius_px=shown.ants.radius_px,
        band_px=shown.ants.grow_px,
        hulls=found.hulls,
    )
    return draw_ant_walk(shown.image.rgb, walk, SCALE)
