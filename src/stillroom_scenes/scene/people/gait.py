"""How a body stands, walks, carries and pushes: the motion of each bone as a function of a few numbers."""

import math
from dataclasses import dataclass

import numpy as np

from stillroom.geometry.arrays import F64
from stillroom_scenes.scene.people import body

LEG_M = 0.92
REST_M = np.zeros((body.BONES, 3))
for _bone, _joint in body.JOINTS_M.items():
    if _bone < body.UPPER_ARM:
        REST_M[_bone] = _joint
    else:
        REST_M[_bone], REST_M[_bone + 1] = np.array(_joint) * (-1, 1, 1), _joint


@dataclass(frozen=True)
class Posture:
    """What a body does at a moment.

    Attributes:
        phase_rad: Place in the walking cycle, 2π for two steps.
        swing_rad: How far the thighs swing; 0 when standing.
        carry: 0 … 1, how far the arms are bent to hold something before the chest.
        push: 0 … 1, how far the arms are stretched out forwards.
        sway_rad: Slow leaning of someone who stands.
        gaze_rad: Turn of the head to the left.
    """

    phase_rad: float = 0.0
    swing_rad: float = 0.0
    carry: float = 0.0
    push: float = 0.0
    sway_rad: float = 0.0
    gaze_rad: float = 0.0


def stride_m(swing_rad: float) -> float:
    """Return the length of two steps [m] of legs that swing so far."""
    return 4.0 * LEG_M * math.sin(swing_rad)


_PARENTS = (
    (body.CHEST, body.PELVIS),
    (body.HEAD, body.CHEST),
    *((body.UPPER_ARM + side, body.CHEST) for side in (0, 1)),
    *((body.FOREARM + side, body.UPPER_ARM + side) for side in (0, 1)),
    *((body.THIGH + side, body.PELVIS) for side in (0, 1)),
    *((body.CALF + side, body.THIGH + side) for side in (0, 1)),
    *((body.FOOT + side, body.CALF + side) for side in (0, 1)),
)
_UPRIGHT = (body.CHEST, body.HEAD)  # they are held against the world, not against what carries them
_OFFSETS_M = {bone: REST_M[bone] - REST_M[parent] for bone, parent in _PARENTS}
_SOLES_M = [body.SOLES_M * (sign, 1, 1) - REST_M[body.FOOT + side] for side, sign in ((0, -1), (1, 1))]


def bone_motions(posture: Posture, scale: float) -> F64:
    """Return the motion (BONES, 4, 4) of each bone from its rest, in the figure's frame, the lower foot on z = 0.

    Args:
        posture: What the body does.
        scale: Its height over that of the rest mesh's.
    """
    rotations = _rotations(_angles_rad(posture))
    joints = np.zeros((body.BONES, 3))
    joints[body.PELVIS] = REST_M[body.PELVIS] + (0.5 * posture.sway_rad, 0.0, 0.0)
    for bone, parent in _PARENTS:
        if bone not in _UPRIGHT:
            rotations[bone] = rotations[parent] @ rotations[bone]
        joints[bone] = joints[parent] + rotations[parent] @ _OFFSETS_M[bone]
    soles = [joints[body.FOOT + k, 2] + _SOLES_M[k] @ rotations[body.FOOT + k, 2] for k in (0, 1)]
    joints[:, 2] -= np.min(soles)
    motions = np.zeros((body.BONES, 4, 4))
    motions[:, :3, :3] = rotations
    motions[:, :3, 3] = scale * (joints - (rotations @ REST_M[..., None])[..., 0])
    motions[:, 3, 3] = 1.0
    return motions


def _rotations(angles_rad: F64) -> F64:
    """Return rotations (N, 3, 3) about x, then y, then z (N, 3); about x, what hangs down goes forwards."""
    cx, cy, cz = np.cos(angles_rad).T
    sx, sy, sz = np.sin(angles_rad).T
    rows = (
        (cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx),
        (sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx),
        (-sy, cy * sx, cy * cx),
    )
    return np.moveaxis(np.array(rows), 2, 0).copy()


def _angles_rad(posture: Posture) -> F64:
    """Return each bone's angles (BONES, 3) about x, y, z, against its parent or (pelvis, chest, head) the world."""
    angles = np.zeros((body.BONES, 3))
    swing, phase, bent = posture.swing_rad, posture.phase_rad, max(posture.carry, posture.push)
    twist = 0.22 * swing * math.sin(phase)
    angles[body.PELVIS] = 0.0, 0.4 * posture.sway_rad, twist
    angles[body.CHEST] = -0.16 * swing - 0.16 * posture.push, posture.sway_rad, -1.2 * twist
    angles[body.HEAD] = -0.06 - 0.15 * posture.carry, 0.3 * posture.sway_rad, posture.gaze_rad
    for side, sign in ((0, -1), (1, 1)):
        at = phase + math.pi * side
        thigh = swing * math.sin(at) + 0.15 * swing
        flex = 0.06 + swing * (0.25 + 1.9 * max(0.0, math.cos(at)) ** 2)
        angles[body.THIGH + side] = thigh, -0.03 * sign, 0.0
        angles[body.CALF + side, 0] = -flex
        angles[body.FOOT + side] = flex - thigh + 0.45 * swing * math.sin(at), 0.0, -0.12 * sign
        free = 0.03 - 0.9 * swing * math.sin(at)
        hang = 0.22 + 0.5 * swing * (1.0 - math.sin(at))
        upper = (1 - bent) * free + 0.5 * posture.carry + 0.95 * posture.push
        elbow = (1 - bent) * hang + posture.carry + 0.3 * posture.push
        angles[body.UPPER_ARM + side] = upper, -0.05 * sign * (1 - bent), 0.0
        angles[body.FOREARM + side] = elbow, 0.16 * sign * bent, 0.0
    return angles
