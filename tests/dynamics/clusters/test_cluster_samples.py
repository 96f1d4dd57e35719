"""Points on clusters, against plain loops and OpenCV's lens."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from small_world import CAMERA, SmallWorld, pose
from staged_things import clusters_of

from stillroom.data.clusters import PLANE, UNKNOWN, Clusters
from stillroom.data.frame import Frame
from stillroom.dynamics.cluster_evidence import STEP_PX, Sampler
from stillroom.geometry.camera import Camera

# A lens worse than any that is sold: a wrong term shows.
BENT = replace(CAMERA, distortion=(0.2, -0.3, 0.004, -0.006, 0.1))


def scene(camera: Camera, size: tuple[int, int] = (480, 640), seed: int = 0) -> tuple[Frame, Clusters]:
    """A frame of rough depth with holes, and five labels in tiles that no step of the samples divides."""
    rng = np.random.default_rng(seed)
    tiles = rng.integers(PLANE, 3, (-(-size[0] // 13), -(-size[1] // 17)))
    labels = np.kron(tiles, np.ones((13, 17))).astype(np.int16)[: size[0], : size[1]]
    depth_m = np.where(rng.random(size) < 0.2, 0.0, rng.uniform(0.5, 5.0, size)).astype(np.float32)
    frame, _ = SmallWorld.of(1, 10).look(pose())
    image = replace(frame.image, depth_m=depth_m)
    return replace(frame, camera=camera, image=image), clusters_of(labels, [-1, -1, -1])


def plainly(frame: Frame, clusters: Clusters) -> list[tuple[int, np.ndarray]]:
    """Every eighth pixel of every eighth row, one after the other."""
    camera, found = frame.camera, []
    for row in range(0, clusters.labels.shape[0], STEP_PX):
        for column in range(0, clusters.labels.shape[1], STEP_PX):
            label, depth_m = clusters.labels[row, column], float(frame.image.depth_m[row, column])
            if label in (PLANE, UNKNOWN) or depth_m == 0:
                continue
            x, y = cv2.undistortPoints(np.array([[[column, row]]], float), camera.K, np.array(camera.distortion))[0, 0]
            found.append((int(label), depth_m * np.array([x, y, 1.0])))
    return found


@pytest.mark.parametrize("camera", [CAMERA, BENT], ids=["straight", "bent"])
@pytest.mark.parametrize("size", [(480, 640), (470, 633)])
def test_samples_are_every_eighth_known_pixel_on_a_cluster(camera: Camera, size: tuple[int, int]) -> None:
    frame, clusters = scene(camera, size)
    samples, expected = Sampler().take(frame, clusters), plainly(frame, clusters)
    assert len(expected) > 1000
    assert samples.cluster.tolist() == [label for label, _ in expected]
    points_m = np.array([point for _, point in expected])
    np.testing.assert_allclose(samples.points_cam_m, points_m, atol=1e-3 if camera is BENT else 1e-6)


def test_samples_lie_in_the_world_where_the_pose_puts_them() -> None:
    samples = Sampler().take(*scene(CAMERA))
    T_world_cam = pose(0.3, -1.0, 2.0, turn=(0.1, 0.5, -0.2))
    expected = samples.points_cam_m @ T_world_cam[:3, :3].T + T_world_cam[:3, 3]
    np.testing.assert_allclose(samples.in_world(np.linalg.inv(T_world_cam)), expected, atol=1e-9)


def test_samples_are_counted_by_cluster() -> None:
    samples = Sampler().take(*scene(CAMERA))
    assert samples.count(3).tolist() == [(samples.cluster == k).sum() for k in range(3)]
    chosen = samples.points_cam_m[:, 2] > 2.0
    assert samples.count(4, chosen).tolist() == [(samples.cluster[chosen] == k).sum() for k in range(3)] + [0]


def test_a_sampler_follows_other_clusters_sizes_and_cameras() -> None:
    sampler = Sampler()
    for camera, size, seed in [(CAMERA, (480, 640), 0), (CAMERA, (480, 640), 1), (BENT, (480, 640), 1)]:
        asked = scene(camera, size, seed)
        np.testing.assert_array_equal(sampler.take(*asked).points_cam_m, Sampler().take(*asked).points_cam_m)
    asked = scene(BENT, (240, 320), 2)
    assert sampler.take(*asked).cluster.tolist() == [label for label, _ in plainly(*asked)]


def test_an_image_without_clusters_has_no_samples() -> None:
    frame, _ = scene(CAMERA)
    samples = Sampler().take(frame, clusters_of(np.full((480, 640), PLANE, dtype=np.int16), []))
    assert len(samples.cluster) == len(samples.points_cam_m) == 0
    assert samples.count(0).tolist() == []
