"""What of a configuration is otherwise with a single camera."""

from dataclasses import replace

from stillroom.config.tree import SlamConfig


def for_single_camera(config: SlamConfig) -> SlamConfig:
    """Return a config whose keyframes and points come as often as depth from motion needs them.

    `monocular` holds the numbers; those of `keyframes`, `mapping`, `recovery` and `last_look` that they replace are for
    cameras that measure depth.
    """
    own = config.monocular
    return replace(
        config,
        keyframes=replace(config.keyframes, share=own.share, min_gap=own.min_gap),
        mapping=replace(
            config.mapping,
            n_neighbours=own.n_neighbours,
            largest_cosine=own.largest_cosine,
            most_turned_deg=own.most_turned_deg,
            n_fused=own.n_neighbours,
            trial_keyframes=own.trial_keyframes,
            min_observations=own.min_observations,
        ),
        recovery=replace(config.recovery, patience=own.patience),
        last_look=replace(config.last_look, enabled=config.last_look.enabled or own.last_look),
    )
