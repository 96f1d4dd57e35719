"""The adapters of devices, against stand-ins for their libraries; the names of these against the installed wheels."""

import importlib
import inspect
import sys
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import stand_in_depthai
import stand_in_realsense

from stillroom.cameras import oak, realsense
from stillroom.cameras.live import GONE_AFTER_S, SLICE_S
from stillroom.cameras.registry import open_camera
from stillroom.errors import CameraError, FrameError, MissingExtraError
from stillroom.geometry.camera import Camera
from stillroom.protocols import CameraStream
from stillroom.testing.camera_contract import check_camera

N_SLICES = round(GONE_AFTER_S / SLICE_S)
LIBRARIES = {"pyrealsense2": stand_in_realsense, "depthai": stand_in_depthai}
PREFIXES = {"pyrealsense2": "camera:realsense", "depthai": "camera:oak"}


def pixels(k: int) -> tuple[np.ndarray, np.ndarray]:
    """Return colours (red first) and depth in millimetres of image k."""
    rgb = np.full((480, 640, 3), (200, 30, 10 + k), dtype=np.uint8)
    units = np.full((480, 640), 1500 + k, dtype=np.uint16)
    units[:, 600:] = 0
    return rgb, units


def realsense_image(k: int) -> stand_in_realsense.Taken:
    return stand_in_realsense.Taken(1.7e12 + 1000.0 * k / 30, *pixels(k))


def oak_image(k: int) -> stand_in_depthai.Taken:
    rgb, units = pixels(k)
    return stand_in_depthai.Taken(timedelta(seconds=12.5 + k / 30), np.ascontiguousarray(rgb[..., ::-1]), units)


IMAGES = {"pyrealsense2": realsense_image, "depthai": oak_image}


@pytest.fixture(autouse=True)
def nothing_plugged() -> Iterator[None]:
    yield
    stand_in_realsense.plugged = stand_in_depthai.plugged = None


@pytest.fixture(params=list(LIBRARIES))
def name(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """The name of a library in whose place its stand-in is."""
    monkeypatch.setitem(sys.modules, request.param, LIBRARIES[request.param])
    return str(request.param)


def plug(name: str, steps: list[Any]) -> Any:
    return LIBRARIES[name].plug(steps)


def asked(name: str, serial: str = "") -> CameraStream:
    return open_camera(PREFIXES[name] + (f":{serial}" if serial else ""))


def test_a_device_keeps_the_contract(name: str) -> None:
    plugged = plug(name, [IMAGES[name](k) for k in range(6)])
    images = check_camera(lambda: asked(name))
    assert asked(name).comes_in_time
    assert [tuple(image.rgb[3, 4]) for image in images] == [(200, 30, 10 + k) for k in range(5)]
    assert [image.depth_m[3, 4] for image in images] == [np.float32(1.5 + k / 1000) for k in range(5)]
    assert not any(image.depth_m[:, 600:].any() for image in images)
    start_s = {"pyrealsense2": 1.7e9, "depthai": 12.5}[name]
    assert np.allclose([image.timestamp_s for image in images], start_s + np.arange(5) / 30, atol=1e-6)
    assert not getattr(plugged, "is_streaming", False)
    assert not getattr(plugged, "is_running", False)
    assert not getattr(plugged, "is_open", False)


def test_the_calibration_is_the_device_s_own(name: str) -> None:
    plugged = plug(name, [IMAGES[name](0)])
    with asked(name) as stream:
        found = stream.camera
    if name == "pyrealsense2":
        distortion = (0.125, -0.25, 0.001, -0.002, 0.0625)
        assert found == Camera(640, 480, 607.5, 606.25, 318.5, 241.75, distortion, 1000.0, 0.075 * 607.5)
        assert plugged.streams == [("color", 640, 480, "rgb8", 30), ("depth", 640, 480, "z16", 30)]
    else:
        assert found == Camera(640, 480, 455.5, 456.5, 321.25, 238.75, depth_factor=1000.0, bf=0.075 * 455.5)
        assert plugged.asked == [("CAM_A", (640, 480), 30, True), *[(f"CAM_{s}", (640, 400), 30, None) for s in "BC"]]


def test_a_device_is_chosen_by_its_serial_number(name: str) -> None:
    plugged = plug(name, [IMAGES[name](0)])
    serial = getattr(plugged, "serial", None) or plugged.device_id
    with asked(name, serial) as stream:
        assert stream.name == f"{PREFIXES[name].removeprefix('camera:')}-{serial}"
        assert stream.next() is not None
    with pytest.raises(
        CameraError, match=r"^camera:\w+:other: does not start \(.* \[see troubleshooting: camera-start"
    ):
        asked(name, "other").__enter__()


def test_no_device_is_one_line(name: str) -> None:
    stream = asked(name)
    with pytest.raises(CameraError, match="is not started"):
        _ = stream.camera
    with pytest.raises(CameraError, match=r"does not start \(No "):
        stream.__enter__()


def test_a_silent_device_is_gone_after_five_seconds_of_waiting(name: str) -> None:
    image = IMAGES[name]
    plugged = plug(name, [image(0), *[None] * (N_SLICES - 1), image(1), *[None] * N_SLICES, image(2)])
    with asked(name) as stream:
        assert [stream.next().index for _ in range(2)] == [0, 1]  # type: ignore[union-attr]
        with pytest.raises(CameraError, match=r"the camera is gone: it has sent nothing for 5 s"):
            stream.next()
    assert plugged.n_waits == 2 * N_SLICES + 1
    assert SLICE_S * N_SLICES == GONE_AFTER_S


def test_an_error_of_the_library_is_a_camera_that_is_gone(name: str) -> None:
    errors = [RuntimeError("No device\nconnected")]
    if name == "depthai":
        errors.append(stand_in_depthai.MessageQueue.QueueException("MessageQueue was closed"))
    for error in errors:
        plug(name, [IMAGES[name](0), error])
        with asked(name) as stream:
            stream.next()
            with pytest.raises(CameraError, match=r"^camera:\w+: the camera is gone \([^\n]+\)$"):
                stream.next()


def test_realsense_without_depth_is_a_frame_that_cannot_be_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyrealsense2", stand_in_realsense)
    lame = stand_in_realsense.Taken(1.7e12 + 33.0, pixels(1)[0], None)
    stand_in_realsense.plug([realsense_image(0), lame, realsense_image(2)])
    with asked("pyrealsense2") as stream:
        assert stream.next().index == 0  # type: ignore[union-attr]
        with pytest.raises(FrameError, match="colour came without depth"):
            stream.next()
        assert stream.next().index == 2  # type: ignore[union-attr]


def test_realsense_with_a_fisheye_lens_is_refused_and_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyrealsense2", stand_in_realsense)
    plugged = stand_in_realsense.plug([realsense_image(0)])
    plugged.model = stand_in_realsense.distortion.kannala_brandt4
    with pytest.raises(CameraError, match="a lens of the model kannala_brandt4"):
        asked("pyrealsense2").__enter__()
    assert not plugged.is_streaming


def test_oak_aligns_depth_as_its_platform_can(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "depthai", stand_in_depthai)
    links = {}
    for platform in stand_in_depthai.Platform:
        plugged = stand_in_depthai.plug([oak_image(0)], platform)
        with asked("depthai") as stream:
            stream.next()
        links[platform.name] = set(plugged.links)
    stereo = {("CAM_B", "StereoDepth.left"), ("CAM_C", "StereoDepth.right"), ("CAM_A", "Sync.colour")}
    assert links["RVC2"] == stereo | {("CAM_A", "StereoDepth.inputAlignTo"), ("StereoDepth.depth", "Sync.depth")}
    assert links["RVC4"] == stereo | {
        ("StereoDepth.depth", "ImageAlign.input"),
        ("CAM_A", "ImageAlign.inputAlignTo"),
        ("ImageAlign.outputAligned", "Sync.depth"),
    }


def test_oak_that_sends_nothing_after_its_start_is_let_go(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "depthai", stand_in_depthai)
    plugged = stand_in_depthai.plug([])
    with pytest.raises(CameraError, match="has sent nothing for 10 s"):
        asked("depthai").__enter__()
    assert (plugged.is_open, plugged.is_running) == (False, False)


@pytest.mark.parametrize(("library", "extra"), [("pyrealsense2", "realsense"), ("depthai", "oak")])
def test_a_missing_library_is_one_line_with_the_way_to_install_it(
    library: str, extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(MissingExtraError, match=rf"^{library} is not installed: pip install 'stillroom\[{extra}\]'$"):
        open_camera(PREFIXES[library])


def test_a_library_that_lacks_one_of_the_system_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = "raise ImportError('libusb-1.0.so.0: cannot open shared object file')\n"
    (tmp_path / "pyrealsense2.py").write_text(broken, encoding="utf-8")
    monkeypatch.delitem(sys.modules, "pyrealsense2", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(CameraError, match=r"^pyrealsense2: does not load \(libusb-1.0.so.0: .*camera-start\]$"):
        open_camera("camera:realsense")


@pytest.mark.parametrize("adapter", [realsense, oak])
def test_an_adapter_is_short(adapter: ModuleType) -> None:
    assert len(inspect.getsource(adapter).splitlines()) <= 100


# Against the installed libraries, where they are.


def installed(library: str) -> Any:
    try:
        return importlib.import_module(library)
    except ImportError as error:
        return pytest.skip(f"{library} cannot be imported ({error})")


def public(thing: object) -> list[str]:
    """Return the names that a class or module of a stand-in offers."""
    members = thing.__members__ if isinstance(thing, type) and hasattr(thing, "__members__") else vars(thing)
    return [name for name in members if not name.startswith("_")]


OUR_OWN = {"Taken", "plug", "plugged", "annotations", "is_aligned_"}


def absent(stand_in: Any, real: Any, path: str = "") -> list[str]:
    """Return what a stand-in offers that the library lacks, in classes within classes too."""
    found = []
    for name in public(stand_in):
        inner = getattr(stand_in, name)
        if name in OUR_OWN or (not path and getattr(inner, "__module__", "") != stand_in.__name__):
            continue
        if not hasattr(real, name):
            found.append(f"{path}{name}")
        elif isinstance(inner, type):
            found += absent(inner, getattr(real, name), f"{path}{name}.")
    return found


@pytest.mark.parametrize("library", LIBRARIES)
def test_every_name_of_a_stand_in_is_one_of_the_library(library: str) -> None:
    stand_in = LIBRARIES[library]
    assert sum(len(public(inner)) for inner in vars(stand_in).values() if isinstance(inner, type)) > 20
    assert absent(stand_in, installed(library)) == []


def test_a_name_that_a_library_lacks_is_found() -> None:
    class Real:
        class device: ...

    assert "device.first_depth_sensor" in absent(stand_in_realsense, Real)
    assert "pipeline" in absent(stand_in_realsense, Real)


def test_depthai_takes_the_arguments_that_are_given() -> None:
    """Its functions are C++, so what they take is told by their first lines."""
    dai = installed("depthai")
    for function, arguments in (
        (dai.Node.Output.createOutputQueue, ("maxSize: ", "blocking: ")),
        (dai.node.Camera.requestOutput, ("size: ", "type: ", "fps: ", "enableUndistortion: ")),
        (dai.MessageQueue.get, ("timeout: datetime.timedelta",)),
        (dai.DeviceInfo.__init__, ("deviceIdOrName: str",)),
        (dai.Pipeline.__init__, ("depthai.Device",)),
        (dai.node.StereoDepth.setSubpixel, ("",)),
    ):
        assert all(argument in function.__doc__ for argument in arguments), function.__doc__
    assert dai.StereoDepthConfig().getDepthUnit().name in oak.UNITS_PER_METRE
    assert not issubclass(dai.MessageQueue.QueueException, RuntimeError)


def test_pyrealsense2_takes_the_arguments_that_are_given() -> None:
    rs = installed("pyrealsense2")
    wanted = rs.config()
    wanted.enable_stream(rs.stream.color, 640, 480, rs.format.rgb8, 30)
    wanted.enable_stream(rs.stream.depth, 640, 480, rs.format.z16, 30)
    wanted.enable_device("012345678901")
    rs.align(rs.stream.color)
    assert "timeout_ms: int" in rs.pipeline.try_wait_for_frames.__doc__
    assert "tuple[bool, " in rs.pipeline.try_wait_for_frames.__doc__.lower()
    models = set(rs.distortion.__members__)
    assert set(realsense.KNOWN_LENSES) < models
    assert set(stand_in_realsense.distortion.__members__) <= models


@pytest.mark.parametrize("library", LIBRARIES)
def test_the_real_library_without_a_device_is_one_line(library: str) -> None:
    installed(library)
    stream = asked(library)
    try:
        stream.__enter__()
    except CameraError as error:
        said = str(error)
    else:
        stream.__exit__(None, None, None)
        pytest.skip("a device is plugged in")
    assert "does not start (No " in said
