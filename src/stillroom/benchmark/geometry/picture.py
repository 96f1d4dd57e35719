"""Four panels of one image: how it differs from an earlier one, plainly and compensated, what moves, the ants' way."""

from pathlib import Path

import numpy as np

from stillroom.benchmark.geometry.onlooker import Shown
from stillroom.dynamics.homography.point_motion import DYNAMIC, UNKNOWN
from stillroom.geometry.arrays import U8
from stillroom.geometry.camera import Camera
from stillroom.viz.film import contact_sheet
from stillroom.viz.geometry import AntWalk, compensated, draw_ant_walk, draw_difference, draw_moving_points
from stillroom.viz.png import write_png

SCALE = 1.5


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
