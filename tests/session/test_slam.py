"""The front door: `import stillroom as sr`, a `Slam` that is given images, and what it leaves of the process."""

import gc
import hashlib
import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import threadpoolctl

import stillroom as sr
from stillroom.errors import ConfigError, FrameError, MapError, StillroomError

NAMES = {
    "Box",
    "Camera",
    "DenseCloud",
    "Evaluation",
    "FrameResult",
    "Image",
    "Instance",
    "MonoImage",
    "Motion",
    "RgbdImage",
    "Semantics",
    "Slam",
    "StereoImage",
    "StillroomError",
    "TrackingState",
    "Trajectory",
    "camera",
    "configure",
    "evaluate",
    "load_map",
    "methods",
    "open_dataset",
    "select",
}
TRUE_BOXES = ("semantics.kind=truth",)
"""The renderer's own boxes stand in for the detector, which is slow and sees no people in drawn rooms."""


def room(frames: str = "0:24"):
    return sr.select(sr.open_dataset("synthetic:walking"), frames)


def settings_of_the_process():
    blas = [library["num_threads"] for library in threadpoolctl.threadpool_info() if library["user_api"] == "blas"]
    return cv2.getNumThreads(), sys.getswitchinterval(), blas


def digest(slam):
    parts = [slam.trajectory().T_world_cam.tobytes(), slam.map.points.position_m.tobytes()]
    parts += [np.array([result.n_inliers for result in slam.system.results]).tobytes()]
    return hashlib.sha256(b"".join(parts)).hexdigest()


def tracked(method, images, camera, seed=0):
    with sr.Slam(method, camera, seed=seed, settings=TRUE_BOXES) as slam:
        for image in images:
            slam.process(image)
    return slam


def test_the_exported_names_are_these_and_each_is_there():
    assert set(sr.__all__) == NAMES
    assert set(dir(sr)) >= NAMES
    for name in NAMES:
        assert getattr(sr, name) is not None


def test_methods_stay_a_function_when_the_rooms_are_imported():
    assert {"orb-slam2", "oc-slam", "pspnet-slam", "dynaslam"} <= set(sr.methods())
    assert sr.methods()["oc-slam"].config.method == "oc-slam"


def test_importing_changes_nothing_and_loads_nothing_heavy():
    code = """
import os, random, sys
before = dict(os.environ), sys.getswitchinterval(), random.getstate(), sys.getrecursionlimit()
import stillroom
assert (dict(os.environ), sys.getswitchinterval(), random.getstate(), sys.getrecursionlimit()) == before
heavy = {"numpy", "cv2", "numba", "scipy", "onnxruntime", "matplotlib"} & set(sys.modules)
assert not heavy, heavy
import cv2, numba, numpy  # cv2 and numba themselves set variables
before = dict(os.environ), cv2.getNumThreads(), numpy.random.get_state()[1].tobytes(), numba.config.CACHE_DIR
stillroom.Slam, stillroom.open_dataset, stillroom.evaluate
after = dict(os.environ), cv2.getNumThreads(), numpy.random.get_state()[1].tobytes(), numba.config.CACHE_DIR
assert after == before, [pair for pair in zip(before, after) if pair[0] != pair[1]]
"""
    subprocess.run([sys.executable, "-c", code], check=True, env={**os.environ})


def test_arrays_that_never_were_a_file_give_what_the_sequence_gives():
    sequence = room()
    camera = sequence.camera
    own = [
        sr.RgbdImage(image.timestamp_s, image.rgb.copy(), image.depth_m.copy(), truth=image.truth) for image in sequence
    ]
    assert [image.index for image in own] == [-1] * len(sequence)
    from_sequence, from_arrays = tracked("oc-slam", sequence, camera), tracked("oc-slam", own, camera)
    assert digest(from_arrays) == digest(from_sequence)
    assert [result.index for result in from_arrays.system.results] == list(range(len(sequence)))


def test_a_rendered_room_is_tracked_and_what_moves_is_returned(tmp_path):
    sequence = room("0:60")
    moving = []
    with sr.Slam("oc-slam", sequence.camera, seed=0, settings=TRUE_BOXES) as slam:
        for image in sequence:
            result = slam.process(image)
            assert result.state is sr.TrackingState.OK
            assert result.T_world_cam.shape == (4, 4)
            assert result.motion.is_static.shape == (len(result.keypoints),)
            moving.append((result.motion.moving, image.truth.movable))
    figures = sr.evaluate(slam.trajectory(), sequence)
    assert figures.coverage == 1.0
    assert figures.as_given.ate_se3_m.rmse < 0.01
    found = np.mean([(seen & true).sum() for seen, true in moving if true.any()])
    wanted = np.mean([true.sum() for _, true in moving if true.any()])
    assert found > 0.5 * wanted
    slam.trajectory().write_tum(tmp_path / "t.tum")
    slam.dense_cloud().write(tmp_path / "room.ply")
    assert sr.evaluate(tmp_path / "t.tum", sequence).as_given.ate_se3_m.rmse == pytest.approx(
        figures.as_given.ate_se3_m.rmse, abs=1e-6
    )
    assert (tmp_path / "room.ply").stat().st_size > 27 * len(slam.dense_cloud())


def test_two_systems_interleaved_and_on_two_threads_give_what_each_gives_alone():
    sequence = room()
    images, camera = list(sequence), sequence.camera
    alone = [digest(tracked("oc-slam", images, camera)), digest(tracked("orb-slam2", images, camera, seed=3))]
    assert alone[0] != alone[1]
    with (
        sr.Slam("oc-slam", camera, seed=0, settings=TRUE_BOXES) as one,
        sr.Slam("orb-slam2", camera, seed=3, settings=TRUE_BOXES) as other,
    ):
        for image in images:
            one.process(image)
            other.process(image)
    assert [digest(one), digest(other)] == alone
    with ThreadPoolExecutor(2) as threads:
        both = [
            threads.submit(tracked, "oc-slam", images, camera),
            threads.submit(tracked, "orb-slam2", images, camera, 3),
        ]
        assert [digest(each.result()) for each in both] == alone


def test_the_settings_of_the_process_are_put_back_when_the_last_system_closes():
    before = settings_of_the_process()
    camera = sr.camera("bonn")
    one = sr.Slam("orb-slam2", camera)
    other = sr.Slam("orb-slam2", camera)
    assert settings_of_the_process()[0] == 1
    assert set(settings_of_the_process()[2]) == {1}
    one.close()
    one.close()
    assert settings_of_the_process()[0] == 1
    other.close()
    assert settings_of_the_process() == before
    with pytest.raises(RuntimeError, match="in the middle"), sr.Slam("orb-slam2", camera):
        raise RuntimeError("in the middle")
    assert settings_of_the_process() == before


def test_a_system_that_is_forgotten_lets_go_of_the_settings():
    before = settings_of_the_process()
    slam = sr.Slam("orb-slam2", sr.camera("bonn"))
    assert settings_of_the_process()[0] == 1
    del slam
    gc.collect()
    assert settings_of_the_process() == before


def workers():
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("stillroom-")]


def test_a_live_system_tracks_while_workers_map_and_leaves_no_thread():
    images = room()
    with sr.Slam("oc-slam", images.camera, settings=TRUE_BOXES, schedule="live") as slam:
        for image in images:
            assert slam.process(image).T_world_cam is not None
        assert len(slam.dense_cloud()) > 10_000  # while frames come: its own worker makes it
        assert workers()
    assert workers() == []
    assert sr.evaluate(slam.trajectory(), images).as_given.ate_se3_m.rmse < 0.01
    assert len(slam.dense_cloud()) > 10_000
    assert workers() == []


def test_a_live_system_that_is_forgotten_leaves_no_thread():
    images = room("0:3")
    slam = sr.Slam("orb-slam2", images.camera, schedule="live")
    for image in images:
        slam.process(image)
    del slam, image
    gc.collect()
    for thread in threading.enumerate():
        if thread.name.startswith("stillroom-"):
            thread.join(60.0)
    assert workers() == []


def test_a_map_is_saved_read_and_localized_in(tmp_path):
    sequence = room("0:60")
    slam = tracked("orb-slam2", list(sequence)[:40], sequence.camera)
    path = tmp_path / "room.stillmap"
    slam.save_map(path)
    stored = sr.load_map(path)
    assert len(stored.world.alive_keyframes()) == len(slam.map.alive_keyframes())
    assert stored.camera == replace(sequence.camera, depth_noise="unknown")  # which a map does not keep
    assert [(session.method, session.first_keyframe) for session in stored.sessions] == [("orb-slam2", 0)]
    assert len(stored.frames) == 40
    before = path.read_bytes()
    with sr.Slam("orb-slam2", sequence.camera, map=path, map_use="localize") as visitor:
        states = [visitor.process(image).state for image in list(sequence)[40:60]]
    assert states[-1] is sr.TrackingState.OK
    assert path.read_bytes() == before
    assert sr.evaluate(visitor.trajectory(), sequence).as_given.ate_se3_m.rmse < 0.02
    with pytest.raises(MapError, match=r"room\.stillmap: .*exists"):
        slam.save_map(path)


def test_a_map_file_grows_as_images_come_and_a_second_session_goes_on_in_it(tmp_path):
    sequence = room("0:60")
    path = tmp_path / "room.stillmap"
    with sr.Slam("orb-slam2", sequence.camera, map=str(path), sequence="first visit") as slam:
        for image in list(sequence)[:30]:
            slam.process(image)
        assert path.stat().st_size > 0
    camera = replace(sequence.camera, readout_s=1e-4, depth_offset_s=1e-9)  # which a map file does not keep
    with sr.Slam("orb-slam2", camera, map=path, map_use="continue") as slam:
        for image in list(sequence)[30:60]:
            slam.process(image)
        slam.save_map(tmp_path / "copy.stillmap")
    assert [session.sequence for session in sr.load_map(path).sessions] == ["first visit", "images from Python"]
    assert len(sr.load_map(tmp_path / "copy.stillmap").sessions) == 2


def test_a_map_file_has_the_poses_of_the_last_look(tmp_path):
    sequence, path = room("0:12"), tmp_path / "room.stillmap"
    settings = ("last_look.enabled=true", "keyframes.min_gap=2", "keyframes.share=0.99")
    with sr.Slam("orb-slam2", sequence.camera, settings=settings, map=path) as slam:
        for image in sequence:
            slam.process(image)
    assert slam.system.last_look.n_improved > 6
    kept = [frame.T_reference_cam for frame in sr.load_map(path).frames]
    np.testing.assert_array_equal(kept, [result.T_reference_cam for result in slam.system.results])


def test_observers_and_a_segmenter_of_ones_own_are_asked(tmp_path):
    sequence = room("0:6")
    told = []

    class Observer:
        def on_frame(self, tracked, semantics, result):
            told.append((result.index, semantics.has_any))

    def all_of_the_left_half_moves(image):
        mask = np.zeros((image.height, image.width), np.bool_)
        mask[:, : image.width // 2] = True
        return sr.Semantics(image.height, image.width, mask=mask)

    with sr.Slam("pspnet-slam", sequence.camera, segmenter=all_of_the_left_half_moves, observers=[Observer()]) as slam:
        results = [slam.process(image) for image in sequence]
    assert told == [(index, True) for index in range(6)]
    for result in results[1:]:
        left = result.keypoints.raw_px[:, 0] < sequence.camera.width // 2 - 1
        assert not result.motion.is_static[left].any()


def broken(image, **changes):
    return sr.RgbdImage(**{"timestamp_s": image.timestamp_s, "rgb": image.rgb, "depth_m": image.depth_m, **changes})


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (lambda i: {"rgb": i.rgb[..., 0]}, r"image 1: rgb is uint8 \(480, 640\); the camera's images are uint8"),
        (lambda i: {"rgb": i.rgb / 255}, "image 1: rgb is float64"),
        (lambda i: {"rgb": i.rgb[::2]}, r"image 1: rgb is uint8 \(240, 640, 3\)"),
        (lambda i: {"depth_m": (i.depth_m * 5000).astype(np.uint16)}, "in metres: divide a sensor's units by 5000, as"),
        (lambda i: {"depth_m": i.depth_m[:, :100]}, r"image 1: depth_m is float32 \(480, 100\); it must be"),
        (lambda i: {"timestamp_s": float("nan")}, "image 1: its time is nan; give it in seconds"),
        (lambda i: {"timestamp_s": 0.0}, r"image 1: its time, 0\.0 s, is not after 0\.0 s, that of the image before"),
    ],
)
def test_an_image_that_cannot_be_is_refused_in_one_line_and_the_next_one_may_come(changes, said):
    sequence = room("0:2")
    first, second = sequence
    with sr.Slam("orb-slam2", sequence.camera) as slam:
        slam.process(first)
        with pytest.raises(FrameError, match=said) as raised:
            slam.process(broken(second, **changes(second)))
        assert "\n" not in str(raised.value)
        assert slam.process(second).state is sr.TrackingState.OK


def test_what_cannot_be_asked_is_said():
    camera = sr.camera("bonn")
    with pytest.raises(ConfigError, match="no method is called 'oc-slm'; did you mean 'oc-slam'"):
        sr.Slam("oc-slm", camera)
    with pytest.raises(ConfigError, match="map_use is 'localise'; it must be one of new, continue, localize"):
        sr.Slam("oc-slam", camera, map="x.stillmap", map_use="localise")
    with pytest.raises(ConfigError, match="map_use is 'localize', which needs a map"):
        sr.Slam("oc-slam", camera, map_use="localize")
    slam = sr.Slam("orb-slam2", camera, settings=["dense.kind=nothing"])
    with pytest.raises(MapError, match="orb-slam2 makes no dense map"):
        slam.dense_cloud()
    with pytest.raises(MapError, match="there is no keyframe yet"):
        slam.save_map("never.stillmap")
    assert not Path("never.stillmap").exists()
    slam.close()
    with pytest.raises(StillroomError, match="this Slam is closed"):
        slam.process(sr.RgbdImage(0.0, np.zeros((480, 640, 3), np.uint8), np.zeros((480, 640), np.float32)))


@pytest.mark.parametrize(("row", "n_repeated"), [(0, 0), (240, 0), (479, 0), (None, 1)])
def test_an_image_that_differs_in_one_pixel_is_no_repetition(row, n_repeated):
    sequence = room()
    image = sequence.load(0)
    rgb = image.rgb.copy()
    if row is not None:
        rgb[row, 0, 0] ^= 1
    with sr.Slam("orb-slam2", sequence.camera) as slam:
        slam.process(image)
        slam.process(replace(image, rgb=rgb, index=1, timestamp_s=image.timestamp_s + 0.03))
    assert slam.system.n_repeated == n_repeated


def test_images_that_repeat_get_the_pose_before_and_change_nothing(caplog):
    sequence = room()
    images = list(sequence)
    twice = [
        replace(image, index=2 * image.index + again, timestamp_s=image.timestamp_s + again / 60)
        for image in images
        for again in (0, 1)
    ]
    once = tracked("oc-slam", images, sequence.camera)
    named = []

    class Observer:
        def on_frame(self, tracked, semantics, result):
            named.append((tracked.frame.image.index, result.index))

    with sr.Slam("oc-slam", sequence.camera, seed=0, settings=TRUE_BOXES, observers=[Observer()]) as slam:
        for image in twice:
            slam.process(image)
    assert slam.system.n_repeated == len(images)
    assert [doubt.name for doubt in slam.doubts] == ["repeated-images"]
    assert named == [(index, index) for index in range(len(twice))]
    np.testing.assert_array_equal(slam.trajectory().T_world_cam[::2], once.trajectory().T_world_cam)
    np.testing.assert_array_equal(slam.trajectory().T_world_cam[1::2], once.trajectory().T_world_cam)
    np.testing.assert_array_equal(slam.dense_cloud().positions_m, once.dense_cloud().positions_m)


def test_a_first_run_that_compiles_says_so_once_and_a_warm_one_is_silent(tmp_path):
    code = """
import logging, sys
import numpy as np
import stillroom as sr
from stillroom.compiled import njit, said_when_compiling
logging.basicConfig(stream=sys.stdout, format="%(message)s")

def plus(a, b):
    return a + b

plus.__module__ = "stillroom.somewhere"
kernel = njit(cache=False)(plus)
for kinds in ((1, 2), (1.0, 2.0)):
    with said_when_compiling():
        kernel(*kinds)
with said_when_compiling():
    kernel(1, 2)
"""
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.count("compiling kernels, which takes a minute or two, once; 'stillroom warmup'") == 1


FIRST_POSE = """
import sys
import numpy as np
import stillroom as sr

camera = sr.Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
gray = np.kron(np.random.default_rng(0).integers(0, 256, (60, 80), dtype=np.uint8), np.ones((8, 8), dtype=np.uint8))
image = sr.RgbdImage(0.0, np.repeat(gray[:, :, None], 3, axis=2), np.full((480, 640), 2.0, dtype=np.float32))
slam = sr.Slam("oc-slam", camera)
assert slam.process(image).T_world_cam is not None
print(*sorted({name.partition(".")[0] for name in sys.modules}), *sys.modules)
"""


def test_a_first_pose_needs_neither_scipy_nor_plots_nor_the_warm_up():
    done = subprocess.run([sys.executable, "-c", FIRST_POSE], check=True, capture_output=True, text=True)
    loaded = set(done.stdout.split())
    assert {"numba", "cv2", "onnxruntime"} <= loaded
    unneeded = {"matplotlib", "scipy.linalg", "scipy.signal", "scipy.sparse", "scipy.spatial", "stillroom.warmup"}
    assert loaded & unneeded == set()


def enlarged(image, times):
    """The image with every pixel repeated, in rows and columns."""
    rgb, depth_m = (np.repeat(np.repeat(pixels, times, axis=0), times, axis=1) for pixels in (image.rgb, image.depth_m))
    boxes = tuple(
        replace(box, **{edge: times * (getattr(box, edge) + 0.5) - 0.5 for edge in EDGES}) for box in image.truth.boxes
    )
    truth = sr.Semantics(times * image.height, times * image.width, boxes)
    return replace(image, rgb=rgb, depth_m=depth_m, truth=truth)


EDGES = ("x_min_px", "y_min_px", "x_max_px", "y_max_px")


@pytest.mark.parametrize("method", ["orb-slam2", "oc-slam"])
def test_a_sequence_of_nine_times_the_pixels_is_tracked_the_same_way(method):
    images = list(room("0:10"))
    small = room().camera
    large = replace(
        small,
        width=3 * small.width,
        height=3 * small.height,
        fx=3 * small.fx,
        fy=3 * small.fy,
        cx=3 * (small.cx + 0.5) - 0.5,
        cy=3 * (small.cy + 0.5) - 0.5,
        bf=3 * small.bf,
    )
    expected = tracked(method, images, small)
    found = tracked(method, (enlarged(image, 3) for image in images), large)
    assert found.config == expected.config, "settings stay as the user gave them"
    poses, wanted = found.trajectory(), expected.trajectory()
    assert len(poses) == len(wanted) == len(images)
    apart_m = np.linalg.norm(poses.T_world_cam[:, :3, 3] - wanted.T_world_cam[:, :3, 3], axis=1)
    assert apart_m.max() < 0.003
