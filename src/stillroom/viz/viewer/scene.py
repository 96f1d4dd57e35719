"""What a run looks like in rerun: each noun in one function, in the colours of the other pictures."""

from collections.abc import Mapping

import cv2
import numpy as np

from stillroom.data.clusters import PLANE, Clusters
from stillroom.data.dense_cloud import DenseCloud
from stillroom.data.motion import Motion
from stillroom.data.result import TrackingState
from stillroom.data.semantics import Box, Semantics
from stillroom.geometry.arrays import F64, U8, Bool, Floats, Ints
from stillroom.geometry.camera import Camera
from stillroom.viz import style
from stillroom.viz.clusters import CLASSES, COLORS, PLANES
from stillroom.viz.marks import BOX, MOVING, STATIC
from stillroom.viz.sparse_map import FRUSTUM, HEIGHTS, INLYING, STROKE
from stillroom.viz.viewer import entities as at
from stillroom.viz.viewer.recording import Recording

JPEG_QUALITY = 80
MATCHED_PX, UNMATCHED_PX = 3.2, 1.8
"""Radii of static keypoints with a map point and without one; dynamic ones have the first."""

FRUSTUM_M, IMAGE_PLANE_M = 0.05, 0.2
"""Depth of a keyframe's frustum, and how far before the camera its image stands [m]."""

LINE_UI, THIN_UI, POINT_UI = -2.4, -0.6, -1.8
"""Radii of lines and points in points of the screen, which rerun tells from metres by the sign."""

MOVABLE_CLASS, MOVING_CLASS, PLANE_CLASS, FIRST_CLUSTER_CLASS = 1, 2, 1, 2
OPACITY = 0.45
COVISIBILITY_COLOR, LOOP_COLOR = style.ESTIMATES[2], style.ESTIMATES[1]
STAGE_COLORS = {
    "frame": style.FAINT,
    "semantics": style.ESTIMATES[4],
    "clusters": style.ESTIMATES[3],
    "features": style.ESTIMATES[0],
    "tracking": style.ESTIMATES[2],
    "mapping": style.ESTIMATES[1],
    "dense": "#8fb8de",
}
"""The stages that are plotted at first; all are recorded, and may be added in the viewer."""

STATES = {TrackingState.OK: STATIC, TrackingState.LOST: MOVING, TrackingState.NOT_INITIALIZED: CLASSES[0]}


class Scene:
    """Shows the nouns of a run in a recording.

    Pixel centres lie at integers here, and half a pixel further in rerun.
    """

    def __init__(self, recording: Recording) -> None:
        """Begin with what does not change."""
        self.recording, self._rr = recording, recording.rr
        rr = self._rr
        recording.log(at.WORLD, rr.ViewCoordinates.RDF, static=True)
        masks = [(0, "", (0, 0, 0, 0)), (MOVABLE_CLASS, "movable", CLASSES[0]), (MOVING_CLASS, "dynamic", MOVING)]
        recording.log(at.MASKS, rr.AnnotationContext(masks), static=True)
        clusters = [(0, "", (0, 0, 0, 0)), (PLANE_CLASS, "plane", PLANES)]
        clusters += [(FIRST_CLUSTER_CLASS + k, "", color) for k, color in enumerate(COLORS)]
        recording.log(at.CLUSTERS, rr.AnnotationContext(clusters), static=True)
        states = rr.StateConfiguration(values=[s.value for s in STATES], colors=list(STATES.values()))
        recording.log(at.STATE, states, static=True)
        names = {"keypoints": _rgb(style.KEYFRAMES), "static": STATIC, "matches": _rgb(style.ESTIMATES[0])}
        for name, color in names.items():
            recording.log([*at.COUNTS.split("/"), name], rr.SeriesLines(colors=color, names=name), static=True)
        for name, shade in STAGE_COLORS.items():
            line = rr.SeriesLines(colors=_rgb(shade), names=name)
            recording.log([*at.STAGES.split("/"), name], line, static=True)
        self._n_boxes, self._had_mask = 0, False
        self._stages: dict[str, None] = {}

    def camera(self, camera: Camera) -> None:
        """Show the frustum of the camera, around its images from then on."""
        rr, K = self._rr, camera.K.copy()
        K[:2, 2] += 0.5
        pinhole = rr.Pinhole(
            image_from_camera=K,
            resolution=(camera.width, camera.height),
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=IMAGE_PLANE_M,
            color=_rgb(style.ESTIMATES[1]),
        )
        self.recording.log(at.CAMERA_IMAGE, pinhole, static=True)

    def image(self, rgb: U8) -> None:
        """Show an image (H, W, 3), RGB, as taken."""
        quality = (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY)
        _, jpeg = cv2.imencode(".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), quality)
        shown = self._rr.EncodedImage(contents=jpeg.tobytes(), media_type="image/jpeg")
        self.recording.log(at.CAMERA_IMAGE, shown)

    def pose(self, T_world_cam: F64 | None) -> None:
        """Show where the camera is (4, 4); where that is unknown it stays where it was."""
        if T_world_cam is not None:
            shown = self._rr.Transform3D(translation=T_world_cam[:3, 3], mat3x3=T_world_cam[:3, :3])
            self.recording.log(at.CAMERA, shown)

    def keypoints(self, raw_px: Floats, is_static: Bool, is_matched: Bool) -> None:
        """Show keypoints (N, 2) of the image as taken [px]: static green, larger where matched (N,), dynamic red."""
        rr, px = self._rr, np.asarray(raw_px, dtype=np.float32) + np.float32(0.5)
        radii = np.where(is_matched[is_static], MATCHED_PX, UNMATCHED_PX)
        self.recording.log(at.STATIC, rr.Points2D(px[is_static], radii=radii, colors=STATIC))
        self.recording.log(at.DYNAMIC, rr.Points2D(px[~is_static], radii=MATCHED_PX, colors=MOVING))

    def semantics(self, semantics: Semantics, motion: Motion) -> None:
        """Show boxes with class and confidence, what is potentially dynamic, what is dynamic, and clusters."""
        self._show_boxes(semantics.boxes)
        has_masks = semantics.mask is not None or bool(semantics.instances)
        has_mask = has_masks or bool(motion.moving.any())
        if has_mask or self._had_mask:  # once empty, it is shown so until there is another one
            labels = np.zeros(motion.moving.shape, dtype=np.uint8)
            if has_masks:
                labels[semantics.movable] = MOVABLE_CLASS
            labels[motion.moving] = MOVING_CLASS
            self.recording.log(at.MASKS, self._rr.SegmentationImage(labels, opacity=OPACITY))
        self._had_mask = has_mask
        if semantics.clusters is not None:
            shown = self._rr.SegmentationImage(cluster_classes(semantics.clusters), opacity=OPACITY)
            self.recording.log(at.CLUSTERS, shown)

    def figures(self, state: TrackingState, counts: Mapping[str, int]) -> None:
        """Show the state of tracking, and counts of keypoints and matches."""
        self.recording.log(at.STATE, self._rr.StateChange(state=state.value))
        for name, count in counts.items():
            self.recording.log([*at.COUNTS.split("/"), name], self._rr.Scalars(float(count)))

    def stages(self, wall_ms: Mapping[str, float]) -> None:
        """Show the time [ms] of each stage in this image; those seen before that did not run took none."""
        self._stages |= dict.fromkeys(wall_ms)
        for name in self._stages:
            self.recording.log([*at.STAGES.split("/"), name], self._rr.Scalars(wall_ms.get(name, 0.0)))

    def path(self, positions_m: Floats, true_m: Floats | None) -> None:
        """Show the camera's path (M, 3), and the true one (Q, 3), aligned with it [m, world]."""
        self._line(at.TRAJECTORY, positions_m, style.ESTIMATES[0])
        if true_m is not None:
            self._line(at.GROUND_TRUTH, true_m, style.TRUTH)

    def keyframes(self, T_world_cam: F64) -> None:
        """Show keyframes (K, 4, 4) as frusta."""
        strokes_m = FRUSTUM_M * FRUSTUM[list(STROKE)]
        lines_m = np.einsum("kij,cj->kci", T_world_cam[:, :3, :3], strokes_m) + T_world_cam[:, None, :3, 3]
        shown = self._rr.LineStrips3D(lines_m.astype(np.float32), colors=_rgb(style.KEYFRAMES), radii=THIN_UI)
        self.recording.log(at.KEYFRAMES, shown)

    def graph(self, positions_m: F64, edges: Ints, loops: Ints) -> None:
        """Show which keyframes see the same points, and which closed loops.

        Args:
            positions_m: Of all keyframes, by id (K, 3) [m, world].
            edges, loops: Ids of the two ends of each edge (E, 2), (L, 2).
        """
        for name, ends, color in ((at.COVISIBILITY, edges, COVISIBILITY_COLOR), (at.LOOPS, loops, LOOP_COLOR)):
            lines_m = positions_m[ends].astype(np.float32).reshape(-1, 2, 3)
            self.recording.log(name, self._rr.LineStrips3D(lines_m, colors=_rgb(color), radii=THIN_UI))

    def points(self, positions_m: Floats) -> None:
        """Show map points (P, 3) [m, world], coloured by height."""
        shown = self._rr.Points3D(positions_m.astype(np.float32), colors=height_colors(positions_m), radii=POINT_UI)
        self.recording.log(at.POINTS, shown)

    def dense(self, cloud: DenseCloud) -> None:
        """Show the dense map."""
        shown = self._rr.Points3D(cloud.positions_m, colors=cloud.rgb, radii=0.5 * cloud.voxel_m)
        self.recording.log(at.DENSE, shown)

    def _show_boxes(self, boxes: tuple[Box, ...]) -> None:
        if not boxes and not self._n_boxes:
            return
        edges = np.array([box.xyxy_px for box in boxes], dtype=np.float32).reshape(-1, 4) + np.float32(0.5)
        shown = self._rr.Boxes2D(
            array=edges,
            array_format=self._rr.Box2DFormat.XYXY,
            labels=[box_label(box) for box in boxes],
            colors=BOX,
        )
        self.recording.log(at.BOXES, shown)
        self._n_boxes = len(boxes)

    def _line(self, path: str, positions_m: Floats, color: str) -> None:
        line = [] if len(positions_m) < 2 else [np.asarray(positions_m, dtype=np.float32)]
        self.recording.log(path, self._rr.LineStrips3D(line, colors=_rgb(color), radii=LINE_UI))


def box_label(box: Box) -> str:
    """Return class and confidence of a box, and over how many frames it was propagated."""
    return f"{box.label} {box.confidence:.2f}" + (f", propagated {box.carried}" if box.carried else "")


def cluster_classes(clusters: Clusters) -> U8:
    """Return the class of each pixel (H, W): 0 unknown, a plane, or one of the colours of clusters in turn."""
    table = np.zeros(len(clusters) + 2, dtype=np.uint8)  # one row a label, the last two for UNKNOWN and PLANE
    table[: len(clusters)] = FIRST_CLUSTER_CLASS + np.arange(len(clusters)) % len(COLORS)
    table[PLANE] = PLANE_CLASS
    return np.asarray(table[clusters.labels], dtype=np.uint8)


def height_colors(positions_m: Floats) -> U8:
    """Return a colour for each point (P, 3) uint8 by its height above the others [m, world: y down]."""
    if len(positions_m) == 0:
        return np.zeros((0, 3), dtype=np.uint8)
    height_m = -np.asarray(positions_m)[:, 1]
    low, high = np.percentile(height_m, INLYING)
    share = np.clip((height_m - low) / max(high - low, 1e-3), 0.0, 1.0)
    table = np.array([_rgb(color) for color in HEIGHTS], dtype=np.float64)
    places = np.linspace(0.0, 1.0, len(table))
    return np.stack([np.interp(share, places, channel) for channel in table.T], axis=1).astype(np.uint8)


def _rgb(color: str) -> tuple[int, int, int]:
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)
