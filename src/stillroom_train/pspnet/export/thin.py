"""Pruning: channels that others can compensate for are left out.

A channel can be pruned where the 1×1 convolutions that read it can compensate with the others. Which, and how, is a
least-squares problem over the activations on pictures: remove the channel that costs least once all weights that read
the others have been refitted, and so on (the optimal brain surgeon, Hassibi and Stork, NIPS 1992, for whole channels).
Where in the network, is decided by how much work a channel is and how much is lost without it, as a share of the
variance of what reads it. There is no retraining.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from stillroom.errors import ConfigError
from stillroom.geometry.arrays import F32, F64, Bool, Ints
from stillroom_train.pspnet.export.moments import second_moments
from stillroom_train.pspnet.export.slim import Slimmed, slim
from stillroom_train.pspnet.export.spaces import Space, spaces, work_of
from stillroom_train.pspnet.networks.steps import AUXILIARY, Architecture, Conv, Step

LOT = 8
"""Channels are pruned in groups of this size: onnxruntime computes that many at once, and would pad others."""

MOST = 0.6
_DAMPING = 1e-4
"""Of the mean variance, added to each channel's: a few pictures do not cover its whole distribution."""


def thin(network: Architecture, weights: Mapping[str, F32], share: float, pictures: Iterable[F32]) -> Slimmed:
    """Return a network with fewer channels, and its weights.

    Args:
        network: The steps; the auxiliary head is forgotten.
        weights: By name.
        share: Share of the work to prune.
        pictures: Inputs of the network (1, 3, H, W), of the kind that it will see.

    Raises:
        ConfigError: The share is impossible, or more than can be left out of this network.
        DatasetError: There are no pictures.
    """
    if not 0.0 <= share <= MOST:
        raise ConfigError(f"thin is {share}; it must be from 0 to {MOST}")
    used = tuple(step for step in network.steps if not step.to.startswith(AUXILIARY))
    network, weights = slim(replace(network, steps=used), weights)
    found = spaces(network)
    _check_room(network, found, share)
    seen_at = {space.value: _read_at(network, space) for space in found}
    values = dict.fromkeys([*seen_at, *(value for places in seen_at.values() for value in places.values())])
    moments = second_moments(network, weights, list(values), pictures)
    problems = [_problem(space, moments, seen_at[space.value], weights) for space in found]
    spared = share * sum(work_of(network).values())
    for problem, stays in zip(problems, _shared_out(problems, spared), strict=True):
        network, weights = _without(network, weights, problem, stays)
    return network, weights


def _check_room(network: Architecture, found: list[Space], share: float) -> None:
    """Refuse to spare more than lies in spaces that can be narrowed; with batch norm there are none."""
    most = sum(LOT * _most_lots(space) * space.work for space in found) / sum(work_of(network).values())
    if share > most:
        raise ConfigError(
            f"thin is {share}; of {network.name} at most {most:.2f} can be pruned"
            + ("" if found else ", as its convolutions have batch norm")
        )


def _most_lots(space: Space) -> int:
    return int(MOST * space.channels) // LOT


@dataclass(frozen=True, eq=False)
class _Problem:
    """A space, its second moments (C + 1, C + 1), and what reads it (M, C + 1), each reader in units of its spread."""

    space: Space
    moments: F64
    read: F64
    spreads: F64


def removals(moments: F64, read: F64, n_removed: int) -> tuple[Ints, F64]:
    """Return the channels to prune, the least important first, and the total loss after each (n_removed,).

    Args:
        moments: Second moments of the channels and of a last one that is always 1 (C + 1, C + 1).
        read: Weights of all that reads them, the bias last (M, C + 1).
        n_removed: Number of channels to prune.

    Returns:
        Numbers of channels, and the mean square of the difference that the best refit leaves.
    """
    inverse, read = np.linalg.inv(_damped(moments)), read.copy()
    products = np.empty_like(inverse), np.empty_like(read)
    gone, lost = np.zeros(n_removed, dtype=np.int64), np.zeros(n_removed)
    left, weight = np.arange(len(moments) - 1), (read**2).sum(axis=0)
    for number in range(n_removed):
        cost = weight[left] / inverse[left, left]
        place = int(cost.argmin())
        channel, lost[number] = left[place], cost[place]
        line, column = inverse[channel] / inverse[channel, channel], read[:, channel].copy()
        weight += line * (line * (column**2).sum() - 2.0 * np.einsum("m,mc->c", column, read))
        # Into memory that is there already: making it again takes most of the time otherwise.
        read -= np.multiply.outer(column, line, out=products[1])
        inverse -= np.multiply.outer(inverse[:, channel], line, out=products[0])
        gone[number] = channel
        left = np.delete(left, place)
    return gone, np.cumsum(lost)


def refit(moments: F64, read: F64, stays: Bool) -> F64:
    """Return the weights that come nearest to all channels' with those that stay (M, left + 1), the bias last.

    Args:
        moments: As in `removals`.
        read: As in `removals`.
        stays: Channels that stay (C,).
    """
    kept = np.append(np.flatnonzero(stays), len(moments) - 1)
    damped = _damped(moments)
    return np.asarray(np.linalg.solve(damped[np.ix_(kept, kept)], damped[kept] @ read.T).T)


def _damped(moments: F64) -> F64:
    channels = np.append(np.ones(len(moments) - 1), 0.0)
    return moments + np.diag(_DAMPING * np.diag(moments)[:-1].mean() * channels)


def _read_at(network: Architecture, space: Space) -> dict[str, str]:
    """Return which value each reader of a space makes, where it reads all of it and not means."""
    return {conv.name: conv.to for conv in network.convolutions if conv.source == space.value and conv.groups == 1}


def _problem(space: Space, moments: Mapping[str, F64], made: Mapping[str, str], weights: Mapping[str, F32]) -> _Problem:
    parts, spreads = [], []
    for name in space.readers:
        part = np.column_stack([weights[f"{name}.weight"][:, :, 0, 0], weights[f"{name}.bias"]]).astype(np.float64)
        # What is lost counts in units of what is made, with what a block adds to: there the same loss says less.
        there = moments[made[name]] if name in made else _moments_through(moments[space.value], part)
        spreads.append(np.full(len(part), np.sqrt(max(_variance(there), 1e-12))))
        parts.append(part)
    spread = np.concatenate(spreads)
    return _Problem(space, moments[space.value], np.vstack(parts) / spread[:, None], spread)


def _moments_through(moments: F64, read: F64) -> F64:
    last = np.append(np.zeros(read.shape[1] - 1), 1.0)
    whole = np.vstack([read, last])
    return np.asarray(whole @ moments @ whole.T)


def _variance(moments: F64) -> float:
    """Return the variance of all channels together."""
    return float(np.trace(moments[:-1, :-1]) - (moments[:-1, -1] ** 2).sum())


def _shared_out(problems: list[_Problem], spared: float) -> list[Bool]:
    """Return which channels of each space stay: groups are pruned where the loss per work is least."""
    orders, losses = [], []
    for problem in problems:
        gone, lost = removals(problem.moments, problem.read, LOT * _most_lots(problem.space))
        orders.append(gone)
        losses.append(np.diff(lost[LOT - 1 :: LOT], prepend=0.0) / (LOT * problem.space.work))
    taken = [0] * len(problems)
    while spared > 0.0:
        rates = [loss[n] if n < len(loss) else np.inf for loss, n in zip(losses, taken, strict=True)]
        least = int(np.argmin(rates))
        taken[least] += 1
        spared -= LOT * problems[least].space.work
    return [
        ~np.isin(np.arange(problem.space.channels), gone[: LOT * n])
        for problem, gone, n in zip(problems, orders, taken, strict=True)
    ]


def _without(network: Architecture, weights: Mapping[str, F32], problem: _Problem, stays: Bool) -> Slimmed:
    """Return the network without the channels that do not stay."""
    space, changed = problem.space, dict(weights)
    for name in (*space.makers, *space.depthwise):
        for part in ("weight", "bias"):
            if f"{name}.{part}" in weights:
                changed[f"{name}.{part}"] = weights[f"{name}.{part}"][stays]
    refitted = refit(problem.moments, problem.read, stays) * problem.spreads[:, None]
    ends = np.cumsum([len(weights[f"{name}.bias"]) for name in space.readers])
    for name, rows in zip(space.readers, np.split(refitted, ends[:-1]), strict=True):
        changed[f"{name}.weight"] = rows[:, :-1, None, None].astype(np.float32)
        changed[f"{name}.bias"] = rows[:, -1].astype(np.float32)
    left = int(stays.sum())

    def narrowed(step: Step) -> Step:
        if not isinstance(step, Conv):
            return step
        first, second = step.channels
        if step.name in space.depthwise:
            return replace(step, channels=(left, left), groups=left)
        first = left if step.name in space.readers else first
        second = left if step.name in space.makers else second
        return replace(step, channels=(first, second))

    return replace(network, steps=tuple(map(narrowed, network.steps))), changed
