"""Depth of keypoints, and depth images, of pairs whose disparity is known: OpenCV's matcher is a second opinion."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from building import parts

from stillroom.data.image import MonoImage, RgbdImage, StereoImage
from stillroom.data.sensor import Sensor
from stillroom.features.dense_stereo import SemiGlobalConfig
from stillroom.features.orb import OrbConfig
from stillroom.features.stereo_matching import StereoConfig
from stillroom.geometry.camera import Camera

CAMERA = Camera(640, 480, 525.0, 525.0, 319.5, 239.5, bf=40.0)
BOX = (slice(150, 330), slice(280, 430))
BOX_PX = 31.25


def texture(seed: int, height: int = 480, width: int = 800) -> np.ndarray:
    """Blobs of all sizes, as surfaces have."""
    rng = np.random.default_rng(seed)
    layers = [cv2.GaussianBlur(rng.normal(0, 1, (height, width)), (0, 0), s) * s for s in (1.2, 2.5, 5.0, 10.0)]
    return cv2.normalize(np.sum(layers, axis=0), None, 0, 255, cv2.NORM_MINMAX).astype(np.float32)


def disparity_px() -> np.ndarray:
    """A wall that turns away to the right, and a box before it; of the left image (H, W) [px]."""
    wall = np.broadcast_to(24.0 - 0.02 * np.arange(640.0), (480, 640)).copy()
    wall[BOX] = BOX_PX
    return wall


def pair(noise: float = 2.0) -> StereoImage:
    """Both images, drawn from what is far to what is near; x in the wall's picture is x of the left image + 80."""
    wall, box = texture(0), texture(1)
    columns, rows = np.meshgrid(np.arange(640.0), np.arange(480.0))
    left = wall[:, 80:720].copy()
    left[BOX] = box[BOX]
    # In the right image x_right = x − d(x), and d is linear on the wall: x = (x_right + 24) / 1.02.
    from_x = ((columns + 24.0) / 1.02 + 80.0).astype(np.float32)
    right = cv2.remap(wall, from_x, rows.astype(np.float32), cv2.INTER_CUBIC)
    moved = cv2.remap(box, (columns + BOX_PX).astype(np.float32), rows.astype(np.float32), cv2.INTER_CUBIC)
    first, last = BOX[1].start - BOX_PX, BOX[1].stop - 1 - BOX_PX
    shown = (columns >= first) & (columns <= last) & (rows >= BOX[0].start) & (rows < BOX[0].stop)
    right[shown] = moved[shown]
    rng = np.random.default_rng(5)
    taken = [np.clip(image + rng.normal(0, noise, image.shape), 0, 255).astype(np.uint8) for image in (left, right)]
    return StereoImage(0.0, np.repeat(taken[0][..., None], 3, axis=2), taken[1], 0)


def near_an_edge(px: np.ndarray, reach_px: float) -> np.ndarray:
    """Which points (N, 2) see both surfaces within a reach."""
    x, y = px.T
    rows, columns = BOX
    outer = (x > columns.start - reach_px) & (x < columns.stop + reach_px) & (y > rows.start - reach_px)
    outer &= y < rows.stop + reach_px
    inner = (x > columns.start + reach_px) & (x < columns.stop - reach_px) & (y > rows.start + reach_px)
    return outer & ~(inner & (y < rows.stop - reach_px))


def true_disparity_px(px: np.ndarray) -> np.ndarray:
    at = np.rint(px).astype(int)
    wall = 24.0 - 0.02 * px[:, 0]
    return np.where(disparity_px()[at[:, 1], at[:, 0]] == BOX_PX, BOX_PX, wall)


def test_keypoints_get_the_depth_of_their_surfaces() -> None:
    image = pair()
    stereo = replace(parts(CAMERA), sensor=Sensor.STEREO)
    frame = OrbConfig().build(stereo, StereoConfig().build(stereo, OrbConfig())).extract(image)
    kp = frame.keypoints
    known = kp.depth_m > 0
    np.testing.assert_array_equal(known, kp.right_px >= 0)
    assert known.mean() > 0.6
    np.testing.assert_allclose(kp.right_px[known], kp.px[known, 0] - CAMERA.bf / kp.depth_m[known], atol=1e-3)
    level_px = frame.scales.factors[kp.octave]
    error_px = CAMERA.bf / kp.depth_m[known] - true_disparity_px(kp.px[known])
    clear = ~near_an_edge(kp.px[known], 20.0)
    assert clear.sum() > 400
    assert np.median(np.abs(error_px[clear] / level_px[known][clear])) < 0.1
    assert np.mean(np.abs(error_px[clear]) < level_px[known][clear]) > 0.98
    # Near the edge a patch may see the other surface: then it has that one's disparity, and not one of its own.
    assert np.mean(np.abs(error_px) < 2.0 * level_px[known]) > 0.9


def test_keypoints_and_semi_global_matching_agree() -> None:
    image = pair()
    stereo = replace(parts(CAMERA), sensor=Sensor.STEREO)
    kp = OrbConfig().build(stereo, StereoConfig().build(stereo, OrbConfig())).extract(image).keypoints
    dense_px = cv2.StereoSGBM.create(0, 64, 5, 200, 800, 1, 31, 10, 100, 2).compute(image.gray, image.right) / 16.0
    at = np.rint(kp.px).astype(int)
    both = (kp.depth_m > 0) & (dense_px[at[:, 1], at[:, 0]] > 0)
    assert both.sum() > 500
    apart_px = np.abs(CAMERA.bf / kp.depth_m[both] - dense_px[at[both, 1], at[both, 0]])
    assert np.median(apart_px) < 0.3
    assert np.mean(apart_px > 3.0) < 0.05


def test_more_keypoints_on_the_right_find_more() -> None:
    image = pair()
    shares = []
    for right_share in (1.0, 2.0):
        stereo = replace(parts(CAMERA), sensor=Sensor.STEREO)
        depth = StereoConfig(right_share=right_share).build(stereo, OrbConfig())
        shares.append(float((OrbConfig().build(stereo, depth).extract(image).keypoints.depth_m > 0).mean()))
    assert shares[1] > shares[0] + 0.05


def test_a_nearest_depth_leaves_out_what_is_nearer() -> None:
    image = pair()
    stereo = replace(parts(CAMERA), sensor=Sensor.STEREO)
    # The box has 31 px, the wall 24 at most: 525 / 19 = 27.6 px.
    depth = StereoConfig(nearest=19.0).build(stereo, OrbConfig())
    kp = OrbConfig().build(stereo, depth).extract(image).keypoints
    assert (kp.depth_m > 0).sum() > 400
    assert CAMERA.bf / kp.depth_m[kp.depth_m > 0].min() < 525.0 / 19.0


def test_what_is_infinitely_far_has_a_finite_depth_where_it_has_any() -> None:
    sky = texture(3)[:, :640]
    gray = np.clip(sky, 0, 255).astype(np.uint8)
    stereo = replace(parts(CAMERA), sensor=Sensor.STEREO)
    extractor = OrbConfig().build(stereo, StereoConfig().build(stereo, OrbConfig()))
    kp = extractor.extract(StereoImage(0.0, np.repeat(gray[..., None], 3, axis=2), gray, 0)).keypoints
    known = kp.depth_m > 0
    assert known.any()
    assert np.isfinite(kp.depth_m).all()
    assert (CAMERA.bf / kp.depth_m[known]).max() < 0.5
    assert (kp.right_px[known] <= kp.px[known, 0]).all()


@pytest.mark.parametrize("left", ["black", "textured"])
def test_a_black_right_image_gives_no_depth(left: str) -> None:
    gray = texture(4)[:, :640].astype(np.uint8) if left == "textured" else np.zeros((480, 640), np.uint8)
    image = StereoImage(0.0, np.repeat(gray[..., None], 3, axis=2), np.zeros((480, 640), np.uint8), 0)
    stereo = replace(parts(CAMERA), sensor=Sensor.STEREO)
    kp = OrbConfig().build(stereo, StereoConfig().build(stereo, OrbConfig())).extract(image).keypoints
    assert (len(kp) == 0) == (left == "black")
    np.testing.assert_array_equal(kp.depth_m, 0.0)
    np.testing.assert_array_equal(kp.right_px, -1.0)


def test_other_images_than_pairs_are_a_mistake_of_the_program() -> None:
    rgb = np.zeros((480, 640, 3), np.uint8)
    stereo = replace(parts(CAMERA), sensor=Sensor.STEREO)
    extractor = OrbConfig().build(stereo, StereoConfig().build(stereo, OrbConfig()))
    with pytest.raises(TypeError, match="monocular images have no right image"):
        extractor.extract(MonoImage(0.0, rgb, 0))
    with pytest.raises(TypeError, match="RGB-D images have no right image"):
        SemiGlobalConfig().build(CAMERA)(RgbdImage(0.0, rgb, np.zeros((480, 640), np.float32), 0))


@pytest.mark.parametrize("side", [(1240, 376), (640, 480), (480, 640), (320, 240), (2560, 1440), (752, 480)])
def test_the_finest_level_is_the_image_itself_up_to_a_size(side: tuple[int, int]) -> None:
    camera = replace(CAMERA, width=side[0], height=side[1])
    longest = max(side)
    finest_px = OrbConfig().scales(camera, Sensor.STEREO).finest_px
    assert longest / finest_px == pytest.approx(min(max(longest, 640), 1280))
    assert OrbConfig().scales(camera).finest_px == camera.pixel_scale


# The depth image.


@pytest.mark.parametrize(("shrink", "median_px", "wrong"), [(1, 0.25, 0.03), (2, 0.35, 0.05)])
def test_a_depth_image_is_that_of_the_surfaces(shrink: int, median_px: float, wrong: float) -> None:
    image = pair()
    depth_m = SemiGlobalConfig(shrink=shrink).build(CAMERA)(image)
    assert depth_m.shape == (480, 640)
    assert depth_m.dtype == np.float32
    known = depth_m > 0
    # The first columns of the left image are not in the right one.
    assert known[:, 40:].mean() > 0.9
    assert known[:, :20].mean() < 0.6
    error_px = np.abs(CAMERA.bf / depth_m[known] - disparity_px()[known])
    assert np.median(error_px) < median_px
    assert np.mean(error_px > 3.0) < wrong


def test_a_depth_image_of_a_pair_that_does_not_match_is_almost_empty() -> None:
    image = replace(pair(), right=texture(9)[:, :640].astype(np.uint8))
    assert np.mean(SemiGlobalConfig().build(CAMERA)(image) > 0) < 0.05


def test_a_depth_image_is_made_where_one_is_wanted() -> None:
    stereo, rgbd = replace(parts(CAMERA), sensor=Sensor.STEREO), parts(CAMERA)
    assert StereoConfig().build_dense(stereo) is None
    assert StereoConfig(dense="sgbm").build_dense(rgbd) is None
    assert StereoConfig(dense="sgbm").build_dense(stereo) is not None
