"""A map for other programs: as COLMAP's model with its images, and as trajectories."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from stillroom.data.image import Image
from stillroom.data.map import Map, submaps
from stillroom.data.replacing import cannot_be_written, replace_text, replacing
from stillroom.data.sensor import Sensor
from stillroom.data.trajectory import Trajectory
from stillroom.errors import MapError
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, I64, U8, Bool
from stillroom.geometry.camera import Camera
from stillroom.storage.schema import StoredMap

GREY = 128
IMAGES = "images"
_CAMERA_ID = 1


# The map as COLMAP's text model (colmap.github.io/format.html): cameras.txt, images.txt, points3D.txt.
#
# COLMAP counts from 1, puts the centre of the upper left pixel at (0.5, 0.5) and stores `T_cam_world`. The keypoints of
# a map are undistorted, so the camera is a pinhole, and the images beside the model are undistorted too.


@dataclass(frozen=True)
class ColmapModel:
    """What was written.

    Attributes:
        files: cameras.txt, images.txt, points3D.txt.
        images: The folder that the names in images.txt are relative to.
        n_images, n_points: Keyframes and points in them.
        n_without_image: Keyframes that were left out, as the map keeps no image of them.
    """

    files: tuple[Path, Path, Path]
    images: Path
    n_images: int
    n_points: int
    n_without_image: int


def write_colmap(stored: StoredMap, images: Iterable[tuple[int, Image]], folder: Path) -> ColmapModel:
    """Write the text model of a map, of its main sub-map where there are several, and the images that it names.

    Args:
        stored: The map.
        images: Keyframes' ids and images, as `keyframe_images` yields them; keyframes without one are left out.
        folder: Where the three files go, and the images, undistorted, below `images/`.

    Raises:
        MapError: There is no image of any keyframe.
        StillroomError: A file cannot be written.
    """
    world, camera = stored.world, stored.camera
    main = submaps.main(world)
    alive = world.alive_keyframes()
    alive = alive[world.keyframes.submap[alive] == main]
    has_image = np.zeros(len(world.keyframes), dtype=np.bool_)
    colours = _Colours(world)
    for keyframe, image in images:
        if keyframe not in alive:
            continue
        rgb = _undistorted(image.rgb, camera)
        _write_png(folder / IMAGES / _image_name(stored, keyframe), rgb)
        colours.add(keyframe, rgb)
        has_image[keyframe] = True
    shown = alive[has_image[alive]]
    if len(shown) == 0:
        raise no_images("a COLMAP model", world.sensor)
    points = np.flatnonzero(world.points.is_alive & (world.points.n_keyframes > 0))
    points = points[submaps.of_points(points, world) == main]
    place, rows = world.observations(points)
    points = points[np.bincount(place, weights=has_image[world.keypoints.keyframe[rows]], minlength=len(points)) > 0]
    files = folder / "cameras.txt", folder / "images.txt", folder / "points3D.txt"
    replace_text(files[0], _camera_line(camera))
    replace_text(files[1], "".join(_image_lines(world, int(k), _image_name(stored, int(k))) for k in shown))
    replace_text(files[2], _point_lines(world, camera, points, has_image, colours.mean()))
    return ColmapModel(files, folder / IMAGES, len(shown), len(points), len(alive) - len(shown))


def no_images(wanted: str, sensor: Sensor) -> MapError:
    """Return what is to be said of a map of a sensor that keeps no images where they are needed."""
    again = "make it again with --set storage.images=true"
    if sensor is Sensor.STEREO:
        again += " --set stereo.dense=sgbm: they are kept with their depth"
    elif sensor is Sensor.MONOCULAR:
        again = "they are kept with their depth, and a single camera has none"
    return MapError(f"the map keeps no images to make {wanted} of; {again} [see troubleshooting: colmap]")


class _Colours:
    """Adds up what colours the keypoints of each point have."""

    def __init__(self, world: Map) -> None:
        self._world = world
        self._sums = np.zeros((len(world.points), 3))
        self._n = np.zeros(len(world.points))

    def add(self, keyframe: int, rgb: U8) -> None:
        """Take the colours of an undistorted image (H, W, 3)."""
        px = np.rint(self._world.keypoints.px[self._world.rows(keyframe)]).astype(np.int64)
        seen = self._world.points_of(keyframe)
        height, width = rgb.shape[:2]
        usable = (seen >= 0) & np.all((px >= 0) & (px < (width, height)), axis=1)
        np.add.at(self._sums, seen[usable], rgb[px[usable, 1], px[usable, 0]])
        np.add.at(self._n, seen[usable], 1)

    def mean(self) -> U8:
        """Return the colour of each point (P, 3); grey where no keypoint of it lies within an image."""
        means = np.where(self._n[:, None] > 0, self._sums / np.maximum(self._n, 1)[:, None], GREY)
        return np.rint(means).astype(np.uint8)


def _undistorted(rgb: U8, camera: Camera) -> U8:
    """Return an image as a pinhole of the same intrinsics would take it; black where the lens saw nothing."""
    if not camera.is_distorted:
        return rgb
    moved: U8 = np.asarray(cv2.undistort(rgb, camera.K, np.asarray(camera.distortion)), dtype=np.uint8)
    return moved


def _write_png(path: Path, rgb: U8) -> None:
    _, png = cv2.imencode(".png", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise cannot_be_written(path, error) from error
    with replacing(path, durable=False) as file:
        file.write(png.tobytes())


def _image_name(stored: StoredMap, keyframe: int) -> str:
    session = max(0, sum(session.first_keyframe <= keyframe for session in stored.sessions) - 1)
    return f"session{session}/{int(stored.world.keyframes.image_index[keyframe]):06d}.png"


def _camera_line(camera: Camera) -> str:
    numbers = camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5
    parameters = " ".join(f"{value:.9g}" for value in numbers)
    return f"# CAMERA_ID MODEL WIDTH HEIGHT fx fy cx cy\n1 PINHOLE {camera.width} {camera.height} {parameters}\n"


def _image_lines(world: Map, keyframe: int, name: str) -> str:
    """Return the two lines of an image: its pose, and its observations."""
    T_cam_world = se3.inverse(world.keyframes.T_world_cam[keyframe])
    x, y, z, w = se3.to_quaternions_xyzw(T_cam_world[None])[0]
    pose = " ".join(f"{value:.12g}" for value in (w, x, y, z, *T_cam_world[:3, 3]))
    px = world.keypoints.px[world.rows(keyframe)] + 0.5
    seen = world.points_of(keyframe)
    ids = np.where(seen >= 0, seen.astype(np.int64) + 1, -1)
    found = " ".join(f"{u:.3f} {v:.3f} {i}" for (u, v), i in zip(px.tolist(), ids.tolist(), strict=True))
    return f"{keyframe + 1} {pose} {_CAMERA_ID} {name}\n{found}\n"


def _point_lines(world: Map, camera: Camera, points: I64, has_image: Bool, colours: U8) -> str:
    """Return a line for each point: where it is, its colour, its mean error [px], and which images show it."""
    place, rows = world.observations(points)
    is_shown = has_image[world.keypoints.keyframe[rows]]
    place, rows = place[is_shown], rows[is_shown]
    keyframes = world.keypoints.keyframe[rows]
    places_px = rows - world.keyframes.first_row[keyframes]
    error_px = _errors_px(world, camera, points[place], rows)
    counts = np.bincount(place, minlength=len(points))
    mean_px = np.bincount(place, weights=error_px, minlength=len(points)) / np.maximum(counts, 1)
    ends, lines = np.cumsum(counts), []
    for i, point in enumerate(points.tolist()):
        views = slice(ends[i] - counts[i], ends[i])
        x, y, z = world.points.position_m[point]
        r, g, b = colours[point]
        seen = zip((keyframes[views] + 1).tolist(), places_px[views].tolist(), strict=True)
        track = " ".join(f"{image} {place_px}" for image, place_px in seen)
        lines.append(f"{point + 1} {x:.9g} {y:.9g} {z:.9g} {r} {g} {b} {mean_px[i]:.4f} {track}\n")
    return "".join(lines)


def _errors_px(world: Map, camera: Camera, points: I64, rows: np.ndarray) -> F64:
    """Return how far each observation (M,) lies from where its point projects to [px]."""
    T_cam_world = se3.inverse(world.keyframes.T_world_cam)[world.keypoints.keyframe[rows]]
    points_world_m = world.points.position_m[points]
    points_cam = np.einsum("nij,nj->ni", T_cam_world[:, :3, :3], points_world_m) + T_cam_world[:, :3, 3]
    errors: F64 = np.linalg.norm(camera.project(points_cam) - world.keypoints.px[rows], axis=1)
    return errors


# The trajectories of a map: the frames of its sessions, at the poses of the current map.


def trajectories(stored: StoredMap) -> list[Trajectory]:
    """Return the trajectory of each session: each frame relative to its reference keyframe's current pose.

    Frames in a sub-map that was not merged with the main one are left out.
    """
    world, found = stored.world, []
    main = submaps.main(world)
    for number in range(len(stored.sessions)):
        frames = [f for f in stored.frames if f.session == number]
        frames = [f for f in frames if world.keyframes.submap[f.reference_keyframe] == main]
        frames.sort(key=lambda frame: frame.timestamp_s)
        poses = [world.placed_by(frame.reference_keyframe, frame.T_reference_cam) for frame in frames]
        times_s = np.array([frame.timestamp_s for frame in frames], dtype=np.float64)
        found.append(_trajectory(times_s, np.array(poses, dtype=np.float64).reshape(-1, 4, 4), world))
    return found


def keyframe_trajectories(stored: StoredMap) -> list[Trajectory]:
    """Return the poses of the keyframes of each session that are alive in the main sub-map."""
    world = stored.world
    alive = world.alive_keyframes()
    alive = alive[world.keyframes.submap[alive] == submaps.main(world)]
    edges = [session.first_keyframe for session in stored.sessions]
    found = []
    for first, end in zip(edges, [*edges[1:], len(world.keyframes)], strict=True):
        own = alive[(alive >= first) & (alive < end)]
        own = own[np.argsort(world.keyframes.timestamp_s[own], kind="stable")]
        found.append(_trajectory(world.keyframes.timestamp_s[own], world.keyframes.T_world_cam[own], world))
    return found


def write_trajectories(stored: StoredMap, folder: Path) -> list[tuple[Path, int]]:
    """Write them in the TUM format; with several sessions, whose times may overlap, a file for each.

    Returns:
        Each file, and how many poses are in it.
    """
    written = []
    kinds = {"trajectory": trajectories(stored), "keyframes": keyframe_trajectories(stored)}
    for name, found in kinds.items():
        for number, trajectory in enumerate(found):
            path = folder / (f"{name}.tum" if len(found) == 1 else f"{name}_{number}.tum")
            trajectory.write_tum(path)
            written.append((path, len(trajectory)))
    return written


def _trajectory(timestamps_s: F64, T_world_cam: F64, world: Map) -> Trajectory:
    return Trajectory(timestamps_s, T_world_cam, world.sensor.is_metric)
