"""What each part of the preset of our own is worth, alone and together with the others."""

from collections.abc import Sequence
from dataclasses import replace

from stillroom.bench.accuracy import NONE, Accuracy, aligned_by
from stillroom.config import SlamConfig
from stillroom.config.kinds import MatchSieveConfig
from stillroom.config.sensors import with_depth
from stillroom.dynamics.cluster_sieve import ClusterSieveConfig
from stillroom.evaluation.report import percent
from stillroom.presets import stillroom as own
from stillroom.tracking.shutter import GLOBAL, ROLLING, DepthNoiseConfig

HEADER = ("what is modelled", "ATE median", "min", "max", "jitter", "faster", "slower", "RPE m/s", "deg/s", "tracked")
"""Names of the columns of `row`; ATE in m, the next three in mm."""
NOTHING, PRIOR, SHUTTER, DEPTH, TURNS, ALL = "nothing", "prior", "shutter", "depth weights", "turn limit", "all"
LIKELY, LOOK, ALL_BUT_LOOK = "p_static", "last look", "all but last look"


def shutter_parts(config: SlamConfig) -> dict[str, SlamConfig]:
    """Return the configs by name, from a method's: nothing, each part alone, all but the last look, and all.

    Values are the method's own where it has a part, else those of `stillroom`; depth weights are always those. Where a
    method has no cluster sieve there are no rows for the turn limit and for weights by p_static. All together, these
    weights are there only if the method has them; `stillroom` does not.
    """
    prior = replace(config.trajectory, enabled=True)
    nothing = replace(
        with_depth(config, DepthNoiseConfig()),
        tracking=replace(config.tracking, shutter=GLOBAL, depth=DepthNoiseConfig()),
        trajectory=replace(config.trajectory, enabled=False),
        last_look=replace(config.last_look, enabled=False),
        dynamics=_limited(config, ClusterSieveConfig().max_turn_rad_s),
    )
    rolling = replace(nothing.tracking, shutter=ROLLING)
    limited, look = _limited(config, _turn_limit(config)), replace(config.last_look, enabled=True)
    unlooked = with_depth(replace(nothing, trajectory=prior, tracking=rolling, dynamics=limited), own.DEPTH)
    parts = {
        NOTHING: nothing,
        PRIOR: replace(nothing, trajectory=prior),
        SHUTTER: replace(nothing, tracking=rolling),
        DEPTH: with_depth(nothing, own.DEPTH),
        TURNS: replace(nothing, dynamics=limited),
        LIKELY: replace(nothing, dynamics=_weighted(nothing.dynamics)),
        LOOK: replace(nothing, last_look=look),
        ALL_BUT_LOOK: unlooked,
        ALL: replace(unlooked, last_look=look),
    }
    if limited == nothing.dynamics:
        del parts[TURNS], parts[LIKELY]
    return parts


def row(accuracy: Accuracy) -> tuple[str, ...]:
    """Return the cells under `HEADER`: ATE's spread, medians, and the worst run's coverage."""
    smooth, rpe = accuracy.smoothness_mm, accuracy.rpe
    return (
        accuracy.method,
        *accuracy.ate_cells(),
        *([NONE] * 3 if smooth is None else [f"{each.median:.1f}" for each in smooth]),
        *([NONE] * 2 if rpe is None else [f"{rpe[0].median:.4f}", f"{rpe[1].median:.3f}"]),
        percent(accuracy.coverage.min),
    )


def sentences(table: Sequence[Accuracy], readout_s: float) -> list[str]:
    """Return notes on how to read the rows; `readout_s`: of the sequence's camera."""
    n = len(table[0].trials)
    lines = [
        f"ATE: RMSE [m] after {aligned_by(table)} alignment, ground truth as given, over {n} run{'s' if n > 1 else ''};"
        " jitter: RMS of the second difference of the position error [mm]; faster, slower: of the error faster and "
        "slower than one second [mm]; RPE over 1 s; tracked: the worst run's share"
    ]
    if readout_s == 0.0:
        lines.append("this camera's readout is 0, a global shutter: modelling a rolling one changes nothing")
    else:
        lines.append(f"readout of this camera: {1e3 * readout_s:.1f} ms")
    return lines


def _turn_limit(config: SlamConfig) -> float:
    """Return the method's own limit where it has one, else that of `stillroom` [rad/s]."""
    ours = own.METHOD.config.dynamics
    assert isinstance(ours, ClusterSieveConfig), "stillroom's own method has one"
    given = config.dynamics
    if isinstance(given, ClusterSieveConfig) and given.max_turn_rad_s < ClusterSieveConfig().max_turn_rad_s:
        return given.max_turn_rad_s
    return ours.max_turn_rad_s


def _limited(config: SlamConfig, max_turn_rad_s: float) -> MatchSieveConfig:
    if not isinstance(config.dynamics, ClusterSieveConfig):
        return config.dynamics
    return replace(config.dynamics, max_turn_rad_s=max_turn_rad_s)


def _weighted(dynamics: MatchSieveConfig) -> MatchSieveConfig:
    return replace(dynamics, weighted=True) if isinstance(dynamics, ClusterSieveConfig) else dynamics
