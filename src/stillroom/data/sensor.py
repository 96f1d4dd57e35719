"""What kind of camera takes the images."""

from enum import StrEnum

from stillroom.errors import ConfigError


class Sensor(StrEnum):
    """What a camera gives of the room.

    Attributes:
        RGBD: Colours, and a depth image registered to them.
        STEREO: A rectified pair of images; keypoints found in both have a depth.
        MONOCULAR: One image; depth comes from motion alone, and trajectory and map are up to scale.
    """

    RGBD = "rgbd"
    STEREO = "stereo"
    MONOCULAR = "monocular"

    @property
    def is_metric(self) -> bool:
        """Whether lengths are in metres; those of a single camera are up to one unknown factor."""
        return self is not Sensor.MONOCULAR

    @property
    def words(self) -> str:
        """Its name in messages."""
        return "RGB-D" if self is Sensor.RGBD else str(self.value)


def sensor_called(name: str) -> Sensor:
    """Return the kind of camera of a name.

    Raises:
        ConfigError: None has it.
    """
    try:
        return Sensor(name)
    except ValueError:
        raise ConfigError(f"sensor is '{name}'; it must be one of {', '.join(Sensor)}") from None
