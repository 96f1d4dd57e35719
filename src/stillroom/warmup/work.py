"""Calls of all kernels: a run with every part, its maps, their pictures, exports and figures, and the renderer."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice

import cv2
import numpy as np

from stillroom.config import SlamConfig
from stillroom.config.kinds import DYNAMICS
from stillroom.data.dense_cloud import DenseCloud
from stillroom.data.frame import Frame
from stillroom.data.image import MonoImage, RgbdImage, StereoImage
from stillroom.data.map import Map
from stillroom.data.motion import Motion
from stillroom.data.question import Question
from stillroom.data.semantics import Box, Semantics
from stillroom.data.sensor import Sensor
from stillroom.datasets.open import open_dataset
from stillroom.dense.dense_mapper import DenseMapperConfig
from stillroom.dense.export.mesh import MeshConfig
from stillroom.dense.export.signed_distance import blocks
from stillroom.dense.inpainting import InpaintingConfig
from stillroom.dense.octomap import OctoMapConfig
from stillroom.dynamics.ants.colony import PathConfig
from stillroom.dynamics.ants.search import ReverseSearchConfig
from stillroom.dynamics.asking import Asking
from stillroom.dynamics.cluster_sieve import ClusterSieveConfig
from stillroom.dynamics.homography.homography_sieve import CompensatedHomographyConfig
from stillroom.dynamics.masked_keypoints import MaskedKeypointsConfig
from stillroom.evaluation.ghost_truth import distances_to_patches_m
from stillroom.evaluation.ghost_views import DepthView, settled, sightings
from stillroom.features.places.growth import GrowthConfig, grow, one_word
from stillroom.features.places.vocabulary import match_by_branch
from stillroom.geometry.arrays import F32, F64, U8
from stillroom.geometry.camera import Camera
from stillroom.geometry.pixels import WIDE_PX
from stillroom.optimize.bundle_kernels import Blocks, Order
from stillroom.optimize.depth_offset import REACH_PX, disparity_planes
from stillroom.optimize.reduced_system import SparseSystem
from stillroom.optimize.trajectory_prior import TrajectoryPriorConfig
from stillroom.protocols import MatchSieve, Parts
from stillroom.semantics.depth_clusters import DepthClustersConfig
from stillroom.semantics.masks.mask_segments import MaskSegments
from stillroom.semantics.masks.refine import RefineConfig, refined
from stillroom.semantics.masks.regions import RegionsConfig, as_semantics
from stillroom.semantics.truth import TrueSemanticsConfig
from stillroom.system import System, build
from stillroom.tracking.last_look import LastLookConfig
from stillroom.tracking.shutter import ROLLING
from stillroom.tracking.tracker import TrackerConfig
from stillroom.viz.cloud.render import CloudRendererConfig
from stillroom.viz.cloud.view import default_view

CAMERA = Camera(640, 480, 525.0, 525.0, 319.5, 239.5, depth_factor=5000.0, bf=40.0)
N_IMAGES = 10
N_ROLLED, READOUT_S = 4, 0.01
PERSON = Box(260.0, 120.0, 380.0, 400.0, "person", confidence=1.0)
PERSON_M = 1.8
"""Near enough to the wall that ghosts there are searched. The person walks as fast as the camera."""
ROUND = 0.8
"""Depth of what is round, as a share of its width: it must not count as a plane."""
RENDERED = ("synthetic:walking,frames=1,cache=off", "synthetic:walking,frames=1,cache=off,noise=off")
PICTURE_PX = 96, 64
N_UNKNOWN_ROWS = 100
"""Rows of each image without depth: points there are triangulated."""
CORRECTION_M = 0.05
ANTS = CompensatedHomographyConfig(ants=ReverseSearchConfig(path=PathConfig(kind="ants")))
"""Choices within parts that bring kernels of their own."""
WALL_M, STEP_PX = 2.0, 16
STEP_M = STEP_PX * WALL_M / CAMERA.fx
PILLAR_M, PILLAR_PX = 1.4, 45
"""How near the pillar stands, and half its width."""


# A synthetic scene: a wall that a camera glides along, something that stands before it, and something that moves.


def images() -> Iterator[RgbdImage]:
    """Yield the images, with the box that a detector would find."""
    rows = CAMERA.height
    wall = _texture(0, rows, CAMERA.width + STEP_PX * N_IMAGES)
    pillar = _texture(1, rows, 2 * PILLAR_PX)
    person = _texture(2, rows, int(PERSON.x_max_px - PERSON.x_min_px))
    truth = Semantics(CAMERA.height, CAMERA.width, (PERSON,))
    for index in range(N_IMAGES):
        rgb = np.ascontiguousarray(wall[:, index * STEP_PX :][:, : CAMERA.width])
        depth_m = np.full(rgb.shape[:2], WALL_M, dtype=np.float32)
        _put(rgb, depth_m, person, (int(PERSON.x_min_px), int(PERSON.y_min_px)), int(PERSON.y_max_px), PERSON_M)
        left_px = 560 - round(index * STEP_M * CAMERA.fx / PILLAR_M)
        _put(rgb, depth_m, pillar, (left_px, 60), 440, PILLAR_M)
        depth_m[:N_UNKNOWN_ROWS] = 0.0
        yield RgbdImage(index / 10.0, rgb, depth_m, index, truth=truth)


def _put(rgb: U8, depth_m: F32, picture: U8, upper_left_px: tuple[int, int], bottom_px: int, nearest_m: float) -> None:
    """Draw something upright and round into an image, in place, as far as it is in it."""
    left, top = upper_left_px
    right = min(left + picture.shape[1], rgb.shape[1])
    across = np.linspace(-1.0, 1.0, picture.shape[1])[: right - left]
    width_m = picture.shape[1] * nearest_m / CAMERA.fx
    rgb[top:bottom_px, left:right] = picture[top:bottom_px, : right - left]
    depth_m[top:bottom_px, left:right] = nearest_m + ROUND * width_m * across**2


def _texture(seed: int, height: int, width: int) -> U8:
    """Return noise (H, W, 3) with corners of every size."""
    rng = np.random.default_rng(seed)
    sizes_px = (8, 16, 32, 64)
    layers = [
        cv2.resize(
            rng.integers(0, 256 // len(sizes_px), (height // size + 1, width // size + 1), dtype=np.uint8),
            (width, height),
            interpolation=cv2.INTER_NEAREST,
        )
        for size in sizes_px
    ]
    gray = np.sum(layers, axis=0).astype(np.uint8)
    return np.repeat(gray[:, :, None], 3, axis=2)


def do_everything() -> None:
    """Track the synthetic scene with all parts, and run all operations on its maps."""
    system = track()
    roll()
    begin_without_depth()
    pair()
    segment()
    recognise(system)
    reduce_sparsely()
    occupy(system)
    cloud = correct(system)
    draw(cloud, system)
    paint_out(cloud, system)
    export(cloud)
    judge(cloud)


def track() -> System:
    """Track the scene; the detector is replaced by one that finds the box."""
    config = SlamConfig(
        semantics=TrueSemanticsConfig(),
        clusters=DepthClustersConfig(),
        dynamics=EverySieveConfig(),
        dense=DenseMapperConfig(),
    )
    system = build(config, CAMERA)
    for image in images():
        system.process(image)
    system.close()
    return system


def roll() -> None:
    """Track the scene as if its rows had been read one after the other, and depth before them, under the prior.

    Through a lens that bends hardly anything.
    """
    rolling = SlamConfig(
        tracking=TrackerConfig(shutter=ROLLING),
        last_look=LastLookConfig(enabled=True),
        trajectory=TrajectoryPriorConfig(enabled=True),
    )
    lens = (0.001, 0.0, 0.0, 0.0, 0.0)
    camera = replace(CAMERA, readout_s=READOUT_S, depth_offset_s=-READOUT_S, distortion=lens)
    system = build(rolling, camera)
    for image in islice(images(), N_ROLLED):
        system.process(replace(image, depth_after_s=camera.depth_offset_s))
        disparity_planes(np.full((1, 2), 200.0), image.depth_m, camera.lens, camera.bf, REACH_PX)
    system.close()
    system.trajectory()


def begin_without_depth() -> None:
    """Track the scene with a single camera."""
    system = build(SlamConfig(), CAMERA, sensor=Sensor.MONOCULAR)
    for image in images():
        system.process(MonoImage(image.timestamp_s, image.rgb, image.index))
    system.close()


def pair() -> None:
    """Find the depth of keypoints in a pair of images."""
    config, image = SlamConfig(), next(images())
    scales = config.features.scales(CAMERA, Sensor.STEREO)
    parts = Parts(CAMERA, Map(scales, Sensor.STEREO), sensor=Sensor.STEREO)
    extractor = config.features.build(parts, config.stereo.build(parts, config.features))
    extractor.extract(StereoImage(image.timestamp_s, image.rgb, np.roll(image.gray, -STEP_PX, axis=1)))


def segment() -> None:
    """Mend a mask by depth, and dilate it."""
    depth_m = np.full((CAMERA.height // 2, CAMERA.width // 2), WALL_M, dtype=np.float32)
    label = np.zeros(depth_m.shape, dtype=np.uint8)
    label[60:200, 130:190] = 1
    depth_m[60:200, 134:194] = PERSON_M
    segments = refined(MaskSegments(label, label.astype(np.float32)), depth_m, RefineConfig())
    as_semantics(segments, ("person",), CAMERA.height, CAMERA.width, 0, RegionsConfig(dilate_px=WIDE_PX))


def recognise(system: System) -> None:
    """Make a small vocabulary of the keyframes, and query which of them is most similar to the newest."""
    world, index = system.map, system.places.index
    newest = int(world.alive_keyframes()[-1])
    descriptors = world.keypoints.descriptors[world.rows(newest)]
    shape = GrowthConfig(branching=2, depth=2)
    grow(one_word(shape.direct_level), [descriptors], shape)
    bag = index.bag(newest)
    system.places.candidates(bag)
    match_by_branch(descriptors, bag.nodes, descriptors, bag.nodes)
    index.remove(newest)
    index.add(newest, bag)


def reduce_sparsely() -> None:
    """Solve for one camera and one point as bundle adjustment does when there are many."""
    starts, slots = np.array([0, 1], dtype=np.int64), np.zeros(1, dtype=np.int64)
    H_cc, one_camera, one_point = np.eye(6)[None], np.zeros((1, 6)), np.zeros((1, 3))
    blocks = Blocks(H_cc, one_camera, np.ones((1, 6)), one_point, np.zeros((1, 3, 6)))
    SparseSystem(1, Order(starts, slots)).solve(blocks, np.ones((1, 6)), 0.0)


def correct(system: System) -> DenseCloud:
    """Move a keyframe, as a closed loop does, and return the dense map, which has followed it."""
    system.map.keyframes.T_world_cam[system.map.alive_keyframes()[0], 2, 3] += CORRECTION_M
    system.dense_mapper.refresh()
    cloud = system.dense_mapper.cloud()
    assert cloud is not None, "the made-up scene is mapped densely"
    return cloud


def occupy(system: System) -> None:
    """Make an occupancy map of two keyframes."""
    octomap = OctoMapConfig().build(Parts(CAMERA, system.map))
    for keyframe, image in zip(system.map.alive_keyframes()[:2], images(), strict=False):
        octomap.integrate(int(keyframe), image)
    octomap.refresh()
    octomap.cloud()


def draw(cloud: DenseCloud, system: System) -> None:
    """Draw the dense map; all other pictures do without kernels."""
    CloudRendererConfig().build().render(cloud, default_view(cloud, system.map.keyframes.T_world_cam, *PICTURE_PX))


def paint_out(cloud: DenseCloud, system: System) -> None:
    """Paint the person out of an image, from a keyframe and from the dense map."""
    painter = InpaintingConfig().build(CAMERA)
    image = next(images())
    assert image.truth is not None
    keyframe = int(system.map.alive_keyframes()[-1])
    painter.remember(keyframe, image, np.zeros_like(image.truth.movable))
    painter.paint(image, system.map.keyframe_pose(keyframe), image.truth.movable, system.map, cloud)


def export(cloud: DenseCloud) -> None:
    """Compute what a mesh is made from; all other formats do without kernels."""
    mesh = MeshConfig()
    for _ in blocks(cloud, cloud.voxel_m * mesh.cell_voxels, mesh.max_weight, mesh.min_points):
        pass


def judge(cloud: DenseCloud) -> None:
    """Look for ghosts in the dense map, by depth images and by a surface."""
    points_m = cloud.positions_m[:64]
    views = [DepthView(image.depth_m, np.eye(4)) for image in islice(images(), 1)]
    sightings(points_m, views, CAMERA, 0.05, 0.03)
    settled(points_m, views, CAMERA, 0.05, 0.03)
    distances_to_patches_m(points_m, np.eye(3).reshape(1, 9), np.zeros(1, dtype=np.bool_))


def render() -> None:
    """Render the synthetic room, with and without noise."""
    for name in RENDERED:
        room = open_dataset(name)
        for index in range(len(room)):
            room.load(index)


@dataclass(frozen=True)
class EverySieveConfig:
    """All sieves that have kernels."""

    def build(self, parts: Parts) -> "EverySieve":
        """Return the sieve."""
        others = [kind() for kind in DYNAMICS.classes.values()]
        return EverySieve(
            ClusterSieveConfig().build(parts), [config.build(parts) for config in (*others, ANTS)], parts.world
        )


class EverySieve:
    """Calls all sieves, and returns the result of one of them."""

    def __init__(self, spokesman: MatchSieve, others: list[MatchSieve], world: Map) -> None:
        """Take them."""
        self._spokesman, self._others = Asking(spokesman, world), [Asking(sieve, world) for sieve in others]
        self._keypoints = MaskedKeypointsConfig().build()

    def judge(self, question: Question) -> Motion:
        """Return the result of the chosen sieve."""
        self._keypoints(question.frame, question.semantics)
        for sieve in self._others:
            sieve.judge(question)
        return self._spokesman.judge(question)

    def remember(self, frame: Frame, T_cam_world: F64, keyframe: int) -> None:
        """Pass the frame to all of them."""
        for sieve in (self._spokesman, *self._others):
            sieve.remember(frame, T_cam_world, keyframe)

    def corrected(self, T_new_old: F64) -> None:
        """Do nothing: each has its own life cycle."""
