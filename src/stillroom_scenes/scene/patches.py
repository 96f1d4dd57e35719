"""Planar patches, the one primitive of the renderer, and the builder that collects them."""

from dataclasses import dataclass

import numpy as np

from stillroom.geometry.arrays import F64, I32


@dataclass(frozen=True)
class Patches:
    """N textured parallelograms or triangles.

    A point of patch i is `corner + s edge_s + t edge_t` with s, t ≥ 0 and s, t ≤ 1 (parallelogram) or
    s + t ≤ 1 (triangle). It is seen only from the side that `edge_s × edge_t` points to.

    Attributes:
        shape_m: Corner, edge_s, edge_t (N, 9) [m], in the world.
        look: Texture coordinates and light (u, v, l) at the corner, their change along edge_s, their change
            along edge_t, (N, 9); u right and v down in [0, 1], l the share of the texture's colour that is seen.
        kind: (N, 3) int32: 1 for a triangle and 0 for a parallelogram; texture; instance (0 is the still room).
    """

    shape_m: F64
    look: F64
    kind: I32

    def __len__(self) -> int:
        """Number of patches."""
        return len(self.shape_m)


def empty() -> Patches:
    """Return no patches."""
    return Patches(np.zeros((0, 9)), np.zeros((0, 9)), np.zeros((0, 3), dtype=np.int32))


def concatenate(parts: list[Patches]) -> Patches:
    """Return all patches of the parts, in their order."""
    if not parts:
        return empty()
    return Patches(
        np.concatenate([part.shape_m for part in parts]),
        np.concatenate([part.look for part in parts]),
        np.concatenate([part.kind for part in parts]),
    )


def moved(patches: Patches, T_world_object: F64) -> Patches:
    """Return patches given in an object's frame in the world's frame; their light stays as it is."""
    vectors = patches.shape_m.reshape(-1, 3, 3) @ T_world_object[:3, :3].T
    vectors[:, 0] += T_world_object[:3, 3]
    return Patches(vectors.reshape(-1, 9), patches.look, patches.kind)
