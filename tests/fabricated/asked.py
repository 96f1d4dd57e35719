"""A sieve as tracking asks it: led through its life, with the frame remembered once the local map was asked."""

from weakref import WeakKeyDictionary

import numpy as np

from stillroom.data.frame import Frame
from stillroom.data.map import Map
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion, Stage
from stillroom.data.question import Pending, Question
from stillroom.data.semantics import Semantics
from stillroom.dynamics.asking import Asking
from stillroom.protocols import MatchSieve

_LED: WeakKeyDictionary[MatchSieve, Asking] = WeakKeyDictionary()


def ask(
    sieve: MatchSieve,
    stage: Stage,
    frame: Frame,
    matches: Matches,
    semantics: Pending[Semantics],
    T_cam_world: np.ndarray,
    world: Map,
) -> Motion:
    """Put a question to a sieve, which is led by the same `Asking` every time."""
    motion = _led(sieve, world).judge(Question(stage, frame, matches, semantics, T_cam_world, world))
    if stage is Stage.LOCAL_MAP:
        _led(sieve, world).remember(frame, T_cam_world, -1)
    return motion


def remember(sieve: MatchSieve, frame: Frame, T_cam_world: np.ndarray, keyframe: int, world: Map) -> None:
    """Let a sieve remember a frame that became a keyframe."""
    _led(sieve, world).remember(frame, T_cam_world, keyframe)


def _led(sieve: MatchSieve, world: Map) -> Asking:
    if sieve not in _LED:
        _LED[sieve] = Asking(sieve, world)
    return _LED[sieve]
