"""A run in a few sentences: those that are printed at its end, and stand in its report."""

from collections.abc import Mapping
from typing import Any

from stillroom.evaluation.report import percent
from stillroom.pipeline.live import live_sentences

TOO_LITTLE = "too little to compare with the ground truth"
NO_TRUTH = "no ground truth to compare with"


def coverage(n_tracked: int, n_recorded: int | None, why: str) -> str:
    """Return how many frames were tracked, and why there are no errors."""
    share = percent(n_tracked / n_recorded if n_recorded else None)
    return f"{n_tracked} of {n_recorded} frames tracked ({share}); {why}"


def before_map(figures: Mapping[str, Any]) -> list[str]:
    """Return which images have no pose because there was no map yet, and what was dropped; nothing where all have."""
    said = []
    n_before, n_dropped = figures.get("n_before_map", 0), figures.get("n_maps_dropped", 0)
    if n_before:
        refused = figures.get("two_views_refused", {})
        counts = ", ".join(f"{n} × {why}" for why, n in refused.items())
        why = f" (pairs of images refused: {counts})" if refused else ""
        images = "1 image has" if n_before == 1 else f"{n_before} images have"
        said.append(f"{images} no pose: a map could not be begun yet{why}")
    if n_dropped:
        maps, them = ("1 map was", "it") if n_dropped == 1 else (f"{n_dropped} maps were", "them")
        n_in_them = figures.get("n_in_dropped_maps", 0)
        images = f"; {n_in_them} images were tracked in {them}, and have no pose" if n_in_them else ""
        said.append(f"{maps} dropped: tracking was lost soon after it began{images}")
    return said


def sentences(figures: Mapping[str, Any], n_given: int | None, has_segmenter: bool = True) -> list[str]:
    """Return what a run came to, beside its errors.

    Args:
        figures: Of the run itself, as `results.run_figures` gives them.
        n_given: Images that it was given; None where that is not known.
        has_segmenter: Whether the method has a detector or a network.
    """
    said = []
    if figures["interrupted"]:
        said.append(f"stopped after {n_given} images; the figures are of these")
    n_bad = figures["n_unreadable"]
    if n_bad:
        said.append(f"not tracked, as they could not be read: {'1 image' if n_bad == 1 else f'{n_bad} images'}")
    if figures.get("scale") == "unknown":
        said.append("one camera knows no scale: trajectory and map are in a unit of their own")
    text = f"map: {figures['n_keyframes']} keyframes, {figures['n_points']} points"
    cost = figures["frame_ms"]
    if cost is not None:
        rate = 1000.0 / cost["wall_mean_ms"]
        text += f"; a frame took {cost['wall_median_ms']:.1f} ms (median), {rate:.1f} frames/s on average"
    said.append(text)
    said += before_map(figures)
    if figures["live"] is not None:
        said += live_sentences(figures["live"], has_segmenter)
    return said
