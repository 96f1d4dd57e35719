"""The data set kind `synthetic`, found by its entry point; the renderer is imported when a room is asked for."""

from stillroom.datasets.kind import DatasetKind, SequenceRequest
from stillroom.errors import ConfigError
from stillroom.protocols import RenderedDataset
from stillroom_scenes import PREFIX


def _open(asked: SequenceRequest, camera: str | None, fps: float | None) -> RenderedDataset:
    if camera is not None or fps is not None:
        raise ConfigError(
            f"{asked.text}: a rendered sequence brings its own camera and times; leave camera and fps out"
        )
    from stillroom_scenes.config import open_synthetic  # the renderer and its kernels, for those who want a room

    return open_synthetic(asked.text, asked.sensor)


KIND = DatasetKind(
    PREFIX,
    "a room with people, rendered: synthetic:walking,frames=300",
    lambda asked: asked.prefix == PREFIX,
    _open,
)
