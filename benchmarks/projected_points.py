"""Print what PSPNet-SLAM's geometry as printed finds on a sequence, and draw one of its images.

The previous frame's features are projected into each image by the homography, and all are tested, at the tracked pose;
see `stillroom.dynamics.projected`. With a stride of 3 the images of a 30 Hz camera are a tenth of a second apart.

    python benchmarks/projected_points.py rgbd_bonn_crowd_first560
    python benchmarks/projected_points.py rgbd_bonn_crowd_first560 --network
    python benchmarks/projected_points.py rgbd_bonn_crowd_first560 --frames 200:560:3
    python benchmarks/projected_points.py rgbd_bonn_crowd_first560 --frames 200:330 --picture 308 projected.png
"""

import argparse
from pathlib import Path

import numpy as np

from stillroom.bench.trial import poses_only
from stillroom.data.matches import Matches
from stillroom.data.motion import Stage
from stillroom.data.question import Question
from stillroom.data.result import FrameResult, Tracked
from stillroom.data.semantics import Semantics, nothing
from stillroom.datasets.open import open_dataset
from stillroom.datasets.selection import select
from stillroom.dynamics.asking import Asking
from stillroom.dynamics.multiview.multiview_kernels import BORDER, DYNAMIC, STATIC, STEEP, UNSEEN
from stillroom.dynamics.projected.paper_ants import PaperAntsConfig, Projected
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, U8
from stillroom.pipeline import RunOptions, run
from stillroom.presets.registry import configure
from stillroom.protocols import Parts
from stillroom.schedule import Done
from stillroom.system import System
from stillroom.viz.film import contact_sheet
from stillroom.viz.geometry_pictures import draw_difference
from stillroom.viz.marks import MOVING, draw_dot, draw_legend, enlarged
from stillroom.viz.marks import STATIC as STANDS
from stillroom.viz.png import write_png

VERDICTS = {STATIC: "static", STEEP: "parallax", BORDER: "border", DYNAMIC: "dynamic", UNSEEN: "no depth there"}
ORANGE = (255, 170, 40)
SCALE = 1.5


class Observer:
    """Tests the projected points of each tracked image, whatever tracks it.

    Attributes:
        counts: Points of each verdict.
        off_px: Median and 95th percentile of each image: how far the homography carries points from where pose and
            depth do (N, 2).
        hulls: Images with a community.
        shown: The picture that was asked for.
    """

    def __init__(self, system: System, network: bool, picture: int | None) -> None:
        self._network, self._picture, self._world = network, picture, system.map
        self._sieve = PaperAntsConfig(search="all").build(Parts(system.mapper.camera, system.map))
        self._asking = Asking(self._sieve, system.map)
        self.counts = dict.fromkeys(VERDICTS, 0)
        self.off_px: list[tuple[float, float]] = []
        self.hulls = 0
        self.shown: U8 | None = None

    def on_frame(self, tracked: Tracked, semantics: Semantics, result: FrameResult) -> None:
        """Test an image."""
        if tracked.T_world_cam is None:
            return
        frame, T_cam_world = tracked.frame, se3.inverse(tracked.T_world_cam)
        known = semantics if self._network else nothing(frame.image.height, frame.image.width)
        unmatched = Matches.of(np.full(len(frame), -1, dtype=np.int32))
        self._asking.judge(Question(Stage.LOCAL_MAP, frame, unmatched, Done(known), T_cam_world, self._world))
        projected = self._sieve.projected
        self._asking.remember(frame, T_cam_world, -1)
        if projected is None:
            return
        for verdict in self.counts:
            self.counts[verdict] += int(np.count_nonzero(projected.test.verdict == verdict))
        self.hulls += bool(projected.found.hulls)
        median_px, far_px = np.percentile(apart_px(projected), (50, 95))
        self.off_px.append((float(median_px), float(far_px)))
        if frame.image.index == self._picture:
            self.shown = drawn(projected, frame.image.rgb, frame.image.gray)

    def close(self) -> None:
        """Nothing is left open."""


def apart_px(projected: Projected) -> F64:
    """Return how far Hx is from where the pose carries each point (N,) [px]."""
    test, camera = projected.test, projected.previous.frame.camera
    by_pose = camera.distort(camera.project(se3.transform(test.there.T_here_cam[0], test.points.cam_m)))
    return np.asarray(np.linalg.norm(test.raw_px - by_pose, axis=1))


def drawn(projected: Projected, rgb: U8, gray: U8) -> U8:
    """Return the difference from the compensation frame, and the projected points by their verdicts."""
    test = projected.test
    picture = enlarged(rgb, SCALE)
    colors = {STATIC: STANDS, STEEP: STANDS, BORDER: ORANGE, DYNAMIC: MOVING}
    for verdict, color in colors.items():
        for point in (test.raw_px[test.verdict == verdict] + 0.5) * SCALE - 0.5:
            draw_dot(picture, point, color, SCALE)
    entries = [(f"{np.count_nonzero(test.verdict == v)} {VERDICTS[v]}", c) for v, c in colors.items() if v != STEEP]
    draw_legend(picture, tuple(entries), SCALE)
    seen = projected.moved.gray > 0
    panels = (
        ("difference from the compensation frame", draw_difference(gray, projected.moved.gray, seen)),
        ("the previous frame's features, projected and tested", picture),
    )
    return contact_sheet([(label, (panel,)) for label, panel in panels], round(SCALE * rgb.shape[1]), per_row=2)


def main() -> None:
    """Run, count, and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequence")
    parser.add_argument("--frames", default=None, metavar="A:B:STEP")
    parser.add_argument("--method", default="pspnet-slam", help="what tracks the camera")
    parser.add_argument("--network", action="store_true", help="leave out what its network masks")
    parser.add_argument("--picture", nargs=2, metavar=("N", "PNG"), default=None)
    asked = parser.parse_args()
    dataset = open_dataset(asked.sequence)
    if asked.frames:
        dataset = select(dataset, asked.frames)
    made: list[Observer] = []

    def observe(system: System) -> Observer:
        made.append(Observer(system, asked.network, int(asked.picture[0]) if asked.picture else None))
        return made[0]

    overrides = ["tracking.between_keyframes=orb"]
    config = poses_only(configure(asked.method, overrides=overrides))
    run(dataset, config, RunOptions(root=None, pictures=0, observe=observe))
    seen = made[0]
    n, off_px = max(1, sum(seen.counts.values())), np.array(seen.off_px).reshape(-1, 2)
    shares = ", ".join(f"{count} {VERDICTS[v]} ({100 * count / n:.2f} %)" for v, count in seen.counts.items())
    print(f"{len(off_px)} images, {n} projected points: {shares}; {seen.hulls} images with a community")
    print(
        f"from where pose and depth carry them: median {np.median(off_px[:, 0]):.2f} px, 95th percentile of an image "
        f"{np.median(off_px[:, 1]):.2f} px, at most {off_px[:, 1].max():.1f} px"
    )
    if asked.picture and seen.shown is not None:
        write_png(Path(asked.picture[1]), seen.shown)


if __name__ == "__main__":
    main()
