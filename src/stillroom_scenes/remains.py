"""The part of a rendered scene that is static in the end: unmoved objects, and moved ones where they were left."""

from dataclasses import dataclass, field

import numpy as np

from stillroom.geometry.arrays import F64, U8, Bool
from stillroom_scenes.render import Scene
from stillroom_scenes.scene.patches import concatenate


@dataclass(frozen=True)
class Remains:
    """The static part of a scene, as a map made until some moment should have it.

    An object that a person moves is static from the moment it is released, where it then is. Before, and while it is
    moved, it counts as the figures do; if it is not released by `end_s`, it does so throughout. An object that is never
    touched until then is static.

    Attributes:
        scene: All that there is to see.
        end_s: The moment.
    """

    scene: Scene = field(repr=False)
    end_s: float

    @property
    def patches_m(self) -> F64:
        """The static surface: corner and two edges of parallelograms and triangles (Q, 9) [m, world]."""
        return self._patches[0]

    @property
    def is_triangle(self) -> Bool:
        """Which of `patches_m` are triangles (Q,)."""
        return self._patches[1]

    @property
    def _patches(self) -> tuple[F64, Bool]:
        resting = [thing for thing in self.scene.objects if not thing.is_moving(self.end_s)]
        patches = concatenate([self.scene.still, *(thing.patches(self.end_s) for thing in resting)])
        return patches.shape_m, patches.kind[:, 0] == 1

    def stays(self, instance: U8, time_s: float) -> Bool:
        """Return which pixels of an image taken at a moment show the static part.

        Args:
            instance: What each pixel shows (H, W), see `FrameTruth`.
            time_s: When it was taken.
        """
        is_static = np.zeros(256, dtype=np.bool_)
        is_static[0] = True
        for thing in self.scene.objects:
            plan = thing.handling
            untouched, let_go = self.end_s <= plan.taken_s, plan.left_s <= time_s
            is_static[thing.instance] = untouched or let_go
        return is_static[instance]
