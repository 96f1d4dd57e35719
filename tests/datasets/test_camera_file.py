"""The user's own camera: what is written is read back, and every slip is told in one line."""

from dataclasses import replace
from pathlib import Path

import pytest

from stillroom.datasets.camera_file import NAMED_CAMERAS, choose_camera, named_camera, read_camera, write_camera
from stillroom.errors import CalibrationError
from stillroom.geometry.camera import Camera

GOOD = """
width = 1280
height = 720
fx = 900.5
fy = 901
cx = 640.25
cy = 360.0
distortion = [0.1, -0.2, 0.001, 0.002, 0]
depth_factor = 1000
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "camera.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", NAMED_CAMERAS)
def test_writing_and_reading_gives_the_same_camera(name: str, tmp_path: Path) -> None:
    write_camera(NAMED_CAMERAS[name], tmp_path / "c.toml")
    assert read_camera(tmp_path / "c.toml") == NAMED_CAMERAS[name]


def test_reads_what_a_user_writes(tmp_path: Path) -> None:
    camera = read_camera(written(tmp_path, GOOD + "baseline_m = 0.05\n"))
    assert camera == Camera(
        1280, 720, 900.5, 901.0, 640.25, 360.0, (0.1, -0.2, 0.001, 0.002, 0.0), 1000.0, bf=900.5 * 0.05
    )
    assert read_camera(written(tmp_path, GOOD + "bf = 40\n")).bf == 40.0


def test_without_a_baseline_takes_a_kinects(tmp_path: Path) -> None:
    assert read_camera(written(tmp_path, GOOD)).baseline_m == pytest.approx(0.075)


def test_without_distortion_has_none(tmp_path: Path) -> None:
    text = "\n".join(line for line in GOOD.splitlines() if not line.startswith("distortion"))
    assert not read_camera(written(tmp_path, text)).is_distorted


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("fx = 900.5", "fxx = 900.5"), "unknown key 'fxx'; did you mean 'fx'?"),
        (("depth_factor", "depth_facter"), "unknown key 'depth_facter'; did you mean 'depth_factor'?"),
        (("distortion", "distorsion"), "unknown key 'distorsion'; did you mean 'distortion'?"),
        (("fy = 901\n", ""), "'fy' is missing"),
        (("fx = 900.5", "fx = '900.5'"), "'fx' is '900.5'; it must be a number"),
        (("fx = 900.5", "fx = true"), "'fx' is True; it must be a number"),
        (("fx = 900.5", "fx = nan"), "fx is nan"),
        (("fx = 900.5", "fx = -900.5"), "fx is -900.5; it must be positive"),
        (("width = 1280", "width = 1280.5"), "'width' is 1280.5; it must be a whole number"),
        (("0.002, 0]", "0.002]"), "must be five numbers"),
        (("[0.1, -0.2, 0.001, 0.002, 0]", "0.1"), "must be five numbers"),
        (("depth_factor = 1000", "depth_factor = 0"), "depth_factor is 0.0; it must be positive"),
        (("width = 1280", "width 1280"), "not a TOML file"),
        (("depth_factor = 1000", "depth_factor = 1000\nbf = 40\nbaseline_m = 0.1"), "leave one out"),
    ],
)
def test_each_slip_is_one_line_that_names_the_file(change: tuple[str, str], said: str, tmp_path: Path) -> None:
    assert change[0] in GOOD
    path = written(tmp_path, GOOD.replace(*change))
    with pytest.raises(CalibrationError) as caught:
        read_camera(path)
    message = str(caught.value)
    assert said in message
    assert message.startswith(str(path))
    assert "\n" not in message


def test_a_missing_file_or_a_folder_is_said(tmp_path: Path) -> None:
    for path in (tmp_path / "none.toml", tmp_path):
        with pytest.raises(CalibrationError, match="no such camera file"):
            read_camera(path)


def test_calibrations_are_the_published_ones() -> None:
    bonn, fr1 = NAMED_CAMERAS["bonn"], NAMED_CAMERAS["tum-freiburg1"]
    assert (bonn.fx, bonn.fy, bonn.cx, bonn.cy) == (542.822841, 542.576870, 315.593520, 237.756098)
    assert bonn.distortion == (0.039903, -0.099343, -0.000730, -0.000144, 0.0)
    assert (fr1.fx, fr1.fy, fr1.cx, fr1.cy) == (517.306408, 516.469215, 318.643040, 255.313989)
    assert fr1.distortion == (0.262383, -0.953104, -0.005358, 0.002628, 1.163314)
    assert not NAMED_CAMERAS["tum-freiburg3"].is_distorted
    assert {c.depth_factor for c in NAMED_CAMERAS.values()} == {5000.0}
    assert {c.bf for c in NAMED_CAMERAS.values()} == {40.0}


@pytest.mark.parametrize("alias", ["fr2", "FR2", "tum2", "freiburg2", "TUM-freiburg2"])
def test_aliases_mean_the_camera(alias: str) -> None:
    assert named_camera(alias) == ("tum-freiburg2", NAMED_CAMERAS["tum-freiburg2"])


def test_an_unknown_name_names_the_nearest() -> None:
    with pytest.raises(CalibrationError, match="did you mean 'bonn'"):
        named_camera("bon")


def test_the_option_beats_the_file_beats_the_name(tmp_path: Path) -> None:
    folder = tmp_path / "rgbd_bonn_crowd"
    folder.mkdir()
    by_name = choose_camera(folder, folder.name, None)
    assert by_name[0] == NAMED_CAMERAS["bonn"]
    assert "rgbd_bonn_" in by_name[1]
    own = written(folder, GOOD)
    by_file = choose_camera(folder, folder.name, None)
    bonn = NAMED_CAMERAS["bonn"]
    assert by_file[0] == replace(read_camera(own), readout_s=bonn.readout_s, depth_noise=bonn.depth_noise)
    assert str(own) in by_file[1]
    by_option = choose_camera(folder, folder.name, "fr3")
    assert by_option == (NAMED_CAMERAS["tum-freiburg3"], "'tum-freiburg3', as given")
    other = tmp_path / "mine.toml"
    write_camera(NAMED_CAMERAS["tum-freiburg2"], other)
    camera, source = choose_camera(folder, folder.name, str(other))
    assert camera == NAMED_CAMERAS["tum-freiburg2"]
    assert str(other) in source


@pytest.mark.parametrize(
    ("sequence", "name"),
    [
        ("rgbd_dataset_freiburg1_rpy_first150", "tum-freiburg1"),
        ("rgbd_dataset_freiburg2_desk_with_person", "tum-freiburg2"),
        ("rgbd_dataset_freiburg3_walking_xyz", "tum-freiburg3"),
    ],
)
def test_recognised_names_bring_their_calibration(sequence: str, name: str, tmp_path: Path) -> None:
    assert choose_camera(tmp_path, sequence, None)[0] == NAMED_CAMERAS[name]


def test_without_any_calibration_says_how_to_give_one(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"give --camera with a name .*or put a camera\.toml into the folder"):
        choose_camera(tmp_path, "my_freiburg1_kitchen", None)


def test_a_path_that_is_no_file_is_no_name_either(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="no such camera file"):
        choose_camera(tmp_path, "x", str(tmp_path / "absent.toml"))


def test_a_readout_is_written_and_read_back(tmp_path: Path) -> None:
    camera = Camera(640, 480, 525.0, 525.0, 319.5, 239.5, readout_s=0.0243)
    write_camera(camera, tmp_path / "camera.toml")
    assert read_camera(tmp_path / "camera.toml") == camera
    assert read_camera(written(tmp_path, GOOD)).readout_s == 0.0
    assert read_camera(written(tmp_path, GOOD + "readout_s = 0.03\n")).readout_s == 0.03


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("-0.01", "readout_s is -0.01; it must be 0 to 0.2 s"),
        ("24", "readout_s is 24.0; it must be 0 to 0.2 s"),
        ("nan", "readout_s is nan"),
        ("'24 ms'", "'readout_s' is '24 ms'; it must be a number"),
        ("true", "'readout_s' is True; it must be a number"),
    ],
)
def test_a_readout_that_no_camera_has_is_refused(value: str, said: str, tmp_path: Path) -> None:
    path = written(tmp_path, GOOD + f"readout_s = {value}\n")
    with pytest.raises(CalibrationError) as caught:
        read_camera(path)
    assert said in str(caught.value)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_sequences_own_file_takes_the_readout_of_its_named_camera_where_it_says_none(tmp_path: Path) -> None:
    written(tmp_path, GOOD)
    camera, source = choose_camera(tmp_path, "rgbd_bonn_balloon", None)
    assert camera.fx == 900.5
    assert camera.readout_s == NAMED_CAMERAS["bonn"].readout_s > 0.0
    assert "readout of 33 ms as of 'bonn'" in source
    assert "\n" not in source
    for name in ("my_room", "rgbd_dataset_freiburg2_desk"):  # of no data set, and of one whose readout is not known
        assert choose_camera(tmp_path, name, None)[0].readout_s == 0.0
    written(tmp_path, GOOD + "readout_s = 0.0\n")
    camera, source = choose_camera(tmp_path, "rgbd_bonn_balloon", None)
    assert camera.readout_s == 0.0, "what the file says counts"
    assert "readout" not in source


def test_what_measures_depth_its_scale_and_its_clock_are_written_and_read_back(tmp_path: Path) -> None:
    camera = Camera(
        640, 480, 525.0, 525.0, 319.5, 239.5, depth_noise="time-of-flight", depth_scale=0.97, depth_offset_s=-0.0151
    )
    write_camera(camera, tmp_path / "c.toml")
    assert read_camera(tmp_path / "c.toml") == camera
    assert camera.units_per_m == pytest.approx(5000.0 / 0.97)
    plain = read_camera(written(tmp_path, GOOD))
    assert (plain.depth_noise, plain.depth_scale, plain.depth_offset_s) == ("unknown", 1.0, 0.0)
    assert plain.units_per_m == 1000.0


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (
            'depth_noise = "sonar"',
            "depth_noise is 'sonar'; it must be one of unknown, structured-light, time-of-flight",
        ),
        ("depth_noise = 3", "'depth_noise' is 3; it must be one of unknown"),
        ("depth_scale = 0.0", "depth_scale is 0.0; it must be positive"),
        ("depth_scale = nan", "depth_scale is nan"),
        ("depth_offset_s = inf", "depth_offset_s is inf; it must be a number of seconds"),
        ("depth_offset_s = '15 ms'", "'depth_offset_s' is '15 ms'; it must be a number"),
    ],
)
def test_depth_that_no_camera_has_is_refused(line: str, said: str, tmp_path: Path) -> None:
    path = written(tmp_path, GOOD + line + "\n")
    with pytest.raises(CalibrationError) as caught:
        read_camera(path)
    assert said in str(caught.value)
    assert str(caught.value).startswith(str(path))


def test_a_sequences_own_file_takes_the_sensor_of_its_named_camera_where_it_says_none(tmp_path: Path) -> None:
    written(tmp_path, GOOD)
    assert choose_camera(tmp_path, "rgbd_bonn_crowd", None)[0].depth_noise == "structured-light"
    assert choose_camera(tmp_path, "my_room", None)[0].depth_noise == "unknown"
    written(tmp_path, GOOD + 'depth_noise = "time-of-flight"\n')
    assert choose_camera(tmp_path, "rgbd_bonn_crowd", None)[0].depth_noise == "time-of-flight"
