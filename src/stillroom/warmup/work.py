"""What calls the kernels: a run with every part, its maps, their pictures, exports and figures, and the renderer."""

from dataclasses import dataclass
from itertools import islice

import numpy as np

from stillroom.config import SlamConfig
from stillroom.config.kinds import DYNAMICS
from stillroom.data.cloud.dense_cloud import DenseCloud
from stillroom.data.frame import Frame
from stillroom.data.map import Map
from stillroom.data.motion import Motion
from stillroom.data.question import Question
from stillroom.datasets.open import open_dataset
from stillroom.dense.dense_mapper import DenseMapperConfig
from stillroom.dense.export.mesh import MeshConfig
from stillroom.dense.export.signed_distance import blocks
from stillroom.dense.inpainting.painter import InpaintingConfig
from stillroom.dynamics.ants.path import PathConfig
from stillroom.dynamics.ants.search import ReverseSearchConfig
from stillroom.dynamics.asking import Asking
from stillroom.dynamics.clusters.sieve import ClusterSieveConfig
from stillroom.dynamics.homography.sieve import CompensatedHomographyConfig
from stillroom.evaluation.ghosts.patches import distances_to_patches_m
from stillroom.evaluation.ghosts.views import DepthView, settled, sightings
from stillroom.features.places.branch_matching import match_by_branch
from stillroom.features.places.growth import GrowthConfig, grow, one_word
from stillroom.geometry.arrays import F64
from stillroom.optimize.bundle_kernels import Blocks, Order
from stillroom.optimize.reduced_system import SparseSystem
from stillroom.protocols import MatchSieve, Parts
from stillroom.semantics.depth_clusters import DepthClustersConfig
from stillroom.semantics.truth import TruthConfig
from stillroom.system import Slam, build
from stillroom.viz.cloud.render import CloudRendererConfig
from stillroom.viz.cloud.view import default_view
from stillroom.warmup.scene import CAMERA, images

RENDERED = ("synthetic:walking,frames=1,cache=off", "synthetic:walking,frames=1,cache=off,noise=off")
PICTURE_PX = 96, 64
CORRECTION_M = 0.05

ANTS = CompensatedHomographyConfig(ants=ReverseSearchConfig(path=PathConfig(kind="ants")))
"""Choices within parts that bring kernels of their own."""


def do_everything() -> None:
    """Track the made-up scene with all parts there are, and do with the maps what can be done with them."""
    slam = track()
    recognise(slam)
    reduce_sparsely()
    cloud = correct(slam)
    draw(cloud, slam)
    paint_out(cloud, slam)
    export(cloud)
    judge(cloud)


def track() -> Slam:
    """Track the scene; the detector is replaced by one that finds the box."""
    config = SlamConfig(
        semantics=TruthConfig(), clusters=DepthClustersConfig(), dynamics=EverySieveConfig(), dense=DenseMapperConfig()
    )
    slam = build(config, CAMERA)
    for image in images():
        slam.process(image)
    slam.close()
    return slam


def recognise(slam: Slam) -> None:
    """Make a small vocabulary of the keyframes, and ask which of them looks like the newest."""
    world, index = slam.map, slam.places.index
    newest = int(world.alive_keyframes()[-1])
    descriptors = world.keypoints.descriptors[world.rows(newest)]
    shape = GrowthConfig(branching=2, depth=2)
    grow(one_word(shape.direct_level), [descriptors], shape)
    bag = index.bag(newest)
    slam.places.candidates(bag)
    match_by_branch(descriptors, bag.nodes, descriptors, bag.nodes)
    index.remove(newest)
    index.add(newest, bag)


def reduce_sparsely() -> None:
    """Solve for one camera and one point as bundle adjustment does when there are many."""
    starts, slots = np.array([0, 1], dtype=np.int64), np.zeros(1, dtype=np.int64)
    H_cc, one_camera, one_point = np.eye(6)[None], np.zeros((1, 6)), np.zeros((1, 3))
    blocks = Blocks(H_cc, one_camera, np.ones((1, 6)), one_point, np.zeros((1, 3, 6)))
    SparseSystem(1, Order(starts, slots)).solve(blocks, np.ones((1, 6)), 0.0)


def correct(slam: Slam) -> DenseCloud:
    """Move a keyframe, as a closed loop does, and return the dense map, which has followed it."""
    slam.map.keyframes.T_world_cam[slam.map.alive_keyframes()[0], 2, 3] += CORRECTION_M
    slam.dense_mapper.refresh()
    cloud = slam.dense_mapper.cloud()
    assert cloud is not None, "the made-up scene is mapped densely"
    return cloud


def draw(cloud: DenseCloud, slam: Slam) -> None:
    """Draw the dense map; all other pictures do without kernels."""
    CloudRendererConfig().build().render(cloud, default_view(cloud, slam.map.keyframes.T_world_cam, *PICTURE_PX))


def paint_out(cloud: DenseCloud, slam: Slam) -> None:
    """Paint the person out of an image, from a keyframe and from the dense map."""
    painter = InpaintingConfig().build(CAMERA)
    image = next(images())
    assert image.truth is not None
    keyframe = int(slam.map.alive_keyframes()[-1])
    painter.remember(keyframe, image, np.zeros_like(image.truth.movable))
    painter.paint(image, slam.map.keyframe_pose(keyframe), image.truth.movable, slam.map, cloud)


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
    """Every part that says what does move."""

    def build(self, parts: Parts) -> "EverySieve":
        """Return the sieve."""
        others = [kind() for kind in DYNAMICS.classes.values()]
        return EverySieve(
            ClusterSieveConfig().build(parts), [config.build(parts) for config in (*others, ANTS)], parts.world
        )


class EverySieve:
    """Puts each question to all sieves, and answers as one of them."""

    def __init__(self, spokesman: MatchSieve, others: list[MatchSieve], world: Map) -> None:
        """Take them."""
        self._spokesman, self._others = Asking(spokesman, world), [Asking(sieve, world) for sieve in others]

    def judge(self, question: Question) -> Motion:
        """Judge as the spokesman does."""
        for sieve in self._others:
            sieve.judge(question)
        return self._spokesman.judge(question)

    def remember(self, frame: Frame, T_cam_world: F64, keyframe: int) -> None:
        """Hand the frame on to all of them."""
        for sieve in (self._spokesman, *self._others):
            sieve.remember(frame, T_cam_world, keyframe)

    def corrected(self, T_new_old: F64) -> None:
        """Do nothing: each is led on its own."""
