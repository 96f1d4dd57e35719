"""A frame with its depth cloud's clusters in colour (OC-SLAM's Figure 7), and with its detections (Figure 3)."""

import cv2
import numpy as np

from stillroom.data.clusters import PLANE, Clusters
from stillroom.data.semantics import Semantics
from stillroom.geometry.arrays import I16, U8, Bool
from stillroom.viz.marks import (
    BOX,
    MOVING,
    Color,
    draw_box,
    draw_label,
    draw_legend,
    draw_outline,
    enlarged,
    mix,
    tint,
)

COLORS: tuple[Color, ...] = (
    (255, 176, 0),
    (54, 162, 255),
    (0, 200, 140),
    (214, 92, 255),
    (255, 112, 67),
    (150, 210, 40),
    (0, 200, 220),
    (255, 110, 180),
    (150, 120, 255),
    (240, 220, 60),
)
"""Of clusters: bright, and none of them the red of dynamic pixels."""

PLANES: Color = (120, 140, 168)
"""Of planes."""

CLASSES: tuple[Color, ...] = ((255, 196, 0), (54, 162, 255), (0, 200, 140), (214, 92, 255), (255, 112, 67))
"""Of boxes, by class."""

FADED = 0.65
"""How much the image is desaturated under the clusters' colours."""

CLUSTER_TINT, PLANE_TINT = 0.55, 0.45
"""Share of their colours."""

LARGE_TEXT = 0.3
"""Size of the labels where nothing but boxes is drawn."""

STEP = 4
"""Neighbours are looked for on every STEP-th pixel, and over a gap of up to REACH of these."""
REACH = 3


def draw_clusters(
    image: U8, clusters: Clusters, semantics: Semantics, moving: Bool | None = None, scale: float = 2.0
) -> U8:
    """Draw clusters on an image: each in a colour of its own, planes grey-blue, moving ones with a red edge.

    Args:
        image: Colours (H, W, 3), RGB, as taken.
        clusters: The clusters of its depth cloud.
        semantics: What is potentially dynamic; its boxes are drawn.
        moving: Dynamic pixels (H, W); a cluster is dynamic when more than half of its pixels are. None: not known.
        scale: How much larger than the image the picture is.

    Returns:
        The picture (H·scale, W·scale, 3), RGB.
    """
    picture = enlarged(_faded(image), scale)
    colors = cluster_colors(clusters)
    _tint_labels(picture, clusters.labels, colors)
    moves = _moving_clusters(clusters, moving)
    # Those that move last, so that no neighbour's edge covers theirs.
    for label in np.argsort(moves, kind="stable"):
        edge = (MOVING, max(1, round(1.5 * scale))) if moves[label] else (colors[label], 1)
        draw_outline(picture, clusters.labels == label, *edge)
    for box in semantics.boxes:
        draw_box(picture, box, scale)
        draw_label(picture, box, scale)
    entries: tuple[tuple[str, Color], ...] = (
        (_count(len(clusters), "cluster"), COLORS[0]),
        (_count(len(clusters.planes), "plane"), PLANES),
    )
    if moving is not None:
        entries += ((f"{int(moves.sum())} moving", MOVING),)
    draw_legend(picture, entries, scale)
    return picture


def draw_detections(image: U8, semantics: Semantics, scale: float = 2.0) -> U8:
    """Draw the boxes that a detector found, one colour a class, and tint the mask where a segmenter gave one.

    Args:
        image: Colours (H, W, 3), RGB, as taken.
        semantics: What is potentially dynamic.
        scale: How much larger than the image the picture is.

    Returns:
        The picture (H·scale, W·scale, 3), RGB.
    """
    picture = enlarged(image, scale)
    if semantics.mask is not None:
        tint(picture, semantics.mask, CLASSES[0], CLUSTER_TINT)
        draw_outline(picture, semantics.mask, CLASSES[0])
    classes = sorted({box.label for box in semantics.boxes})
    colors = {label: CLASSES[place % len(CLASSES)] for place, label in enumerate(classes)}
    # The most confident last, and all labels after all edges, so that they can be read.
    boxes = sorted(semantics.boxes, key=lambda box: box.confidence)
    for box in boxes:
        draw_box(picture, box, scale, colors[box.label], max(1, round(scale)))
    for box in boxes:
        draw_label(picture, box, scale, colors[box.label], LARGE_TEXT)
    counts = [(label, sum(box.label == label for box in semantics.boxes)) for label in classes]
    entries = tuple((f"{label}: {n}", colors[label]) for label, n in counts)
    draw_legend(picture, entries or (("nothing detected", BOX),), scale)
    return picture


def cluster_colors(clusters: Clusters) -> tuple[Color, ...]:
    """Return a colour for each cluster (K), others for those that touch each other in the image."""
    neighbours = _neighbours(clusters.labels, len(clusters))
    chosen: list[int] = []
    for label in range(len(clusters)):
        taken = {chosen[other] for other in np.flatnonzero(neighbours[label, :label])}
        turn = [(label + k) % len(COLORS) for k in range(len(COLORS))]
        chosen.append(next((color for color in turn if color not in taken), turn[0]))
    return tuple(COLORS[color] for color in chosen)


def _tint_labels(picture: U8, labels: I16, colors: tuple[Color, ...]) -> None:
    """Mix each label's colour into a picture, in place."""
    # One row a label, from PLANE and UNKNOWN up: colour times share, and share.
    table = np.zeros((len(colors) + 2, 4), dtype=np.float32)
    table[PLANE + 2] = [*(PLANE_TINT * np.array(PLANES)), PLANE_TINT]
    for label, color in enumerate(colors):
        table[label + 2] = [*(CLUSTER_TINT * np.array(color)), CLUSTER_TINT]
    mix(picture, table[labels.astype(np.int64) + 2])


def _neighbours(labels: I16, n: int) -> Bool:
    """Return which clusters come near each other (K, K)."""
    near = np.zeros((n, n), dtype=np.bool_)
    small = labels[::STEP, ::STEP].astype(np.int64)
    height, width = small.shape
    for dy in range(REACH + 1):
        for dx in range(-REACH, REACH + 1):
            here = small[: height - dy, max(0, -dx) : width - max(0, dx)]
            there = small[dy:, max(0, dx) : width - max(0, -dx)]
            both = (here >= 0) & (there >= 0) & (here != there)
            near[here[both], there[both]] = True
    return near | near.T


def _moving_clusters(clusters: Clusters, moving: Bool | None) -> Bool:
    """Return which clusters (K,) have more than half of their pixels in a mask."""
    if moving is None:
        return np.zeros(len(clusters), dtype=np.bool_)
    clustered = clusters.labels >= 0
    n_all = np.bincount(clusters.labels[clustered], minlength=len(clusters))
    n_moving = np.bincount(clusters.labels[clustered & moving], minlength=len(clusters))
    return np.asarray(2 * n_moving > n_all, dtype=np.bool_)


def _faded(image: U8) -> U8:
    """Take most of the colour out of an image, and some of the contrast, so that the clusters' colours stand out."""
    gray = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
    return np.asarray(cv2.addWeighted(gray, FADED, image, 1.0 - FADED, 0.0), dtype=np.uint8)


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}{'' if n == 1 else 's'}"
