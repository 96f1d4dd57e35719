"""Depth that reads too far, or is stamped late: what the renderer does to it, and to nothing else."""

import numpy as np
import pytest

from stillroom.errors import ConfigError
from stillroom_scenes.config import open_synthetic

WALK = "synthetic:walking,frames=4,noise=off,cache=off"
UNIT_M = 1.0 / 5000.0


def test_depth_reads_too_far_by_the_scale_and_the_camera_does_not_know() -> None:
    room, sound = open_synthetic(f"{WALK},depth_scale=1.03"), open_synthetic(WALK)
    image = room.load(2)
    known = image.depth_m > 0
    assert known.mean() > 0.9
    np.testing.assert_allclose(image.depth_m[known], 1.03 * room.truth(2).depth_m[known], atol=0.6 * UNIT_M, rtol=1e-6)
    assert (image.rgb == sound.load(2).rgb).all()
    assert room.camera == sound.camera
    assert room.name == f"{sound.name}_depth1.03"


def test_depth_that_is_stamped_late_is_that_of_earlier() -> None:
    room, sound = open_synthetic(f"{WALK},depth_late_ms={1000 / 30!r}"), open_synthetic(WALK)
    image = room.load(3)
    np.testing.assert_allclose(image.depth_m, sound.load(2).depth_m, atol=1.1 * UNIT_M)
    assert np.abs(image.depth_m - sound.load(3).depth_m).max() > 0.1
    assert (image.rgb == sound.load(3).rgb).all()
    assert image.depth_after_s == 0.0
    assert image.timestamp_s == sound.load(3).timestamp_s


def test_the_noise_of_the_sensor_is_that_of_what_it_reads() -> None:
    far, sound = (
        open_synthetic(f"synthetic:empty,frames=1,cache=off{more}").load(0) for more in (",depth_scale=1.1", "")
    )
    both = (far.depth_m > 0) & (sound.depth_m > 0)
    assert np.median(far.depth_m[both] / sound.depth_m[both]) == pytest.approx(1.1, abs=0.002)


def test_a_readout_that_is_stated_wrongly_changes_the_calibration_alone() -> None:
    spec = "synthetic:walking,frames=1,cache=off,readout_ms=20"
    true, stated = open_synthetic(spec), open_synthetic(f"{spec},stated_readout_ms=0")
    assert (true.camera.readout_s, stated.camera.readout_s) == (0.02, 0.0)
    np.testing.assert_array_equal(stated.load(0).rgb, true.load(0).rgb)
    assert stated.name != true.name


@pytest.mark.parametrize(
    "wrong", ["depth_scale=0.4", "depth_scale=nan", "depth_late_ms=501", "depth_late_ms=nan", "stated_readout_ms=-2"]
)
def test_impossible_faults_are_refused(wrong: str) -> None:
    with pytest.raises(ConfigError, match=f"synthetic: {wrong.split('=')[0]} is"):
        open_synthetic(f"{WALK},{wrong}")
