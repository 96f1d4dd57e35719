"""A dense map from the images that a map file keeps of its keyframes."""

from dataclasses import replace
from pathlib import Path

from stillroom.data.cloud.dense_cloud import DenseCloud
from stillroom.dense.dense_mapper import DenseMapperConfig
from stillroom.errors import MapError
from stillroom.protocols import Parts
from stillroom.storage.reader import keyframe_images
from stillroom.storage.stored import StoredMap


def dense_cloud(path: Path, stored: StoredMap, config: DenseMapperConfig | None = None) -> DenseCloud:
    """Fuse the kept images under the poses that the map now gives them; what moved has no depth in them.

    Args:
        path: The map file.
        stored: What was loaded of it.
        config: How to fuse.

    Raises:
        MapError: The file keeps no images, or is damaged.
    """
    # A keyframe that is out of date is no witness here: all are fused under their last poses.
    config = config or replace(DenseMapperConfig(), correction_m=0.0, corrections=0)
    mapper, n_fused = config.build(Parts(stored.camera, stored.world)), 0
    for keyframe, image in keyframe_images(path):
        mapper.integrate(keyframe, image)
        n_fused += 1
    if n_fused == 0:
        raise MapError(f"{path}: keeps no images to make a dense map of; run with --set storage.images=true")
    return mapper.cloud()
