"""What every map must fulfil, and what is in it."""

import numpy as np

from stillroom.data.map import Map


def contents(world: Map) -> dict[str, np.ndarray]:
    """Return a copy of all there is, by name."""
    tables = {"keyframes": world.keyframes, "points": world.points, "keypoints": world.keypoints}
    found = {f"{table}.{name}": view.copy() for table, t in tables.items() for name, view in t.views.items()}
    return found | {"covisibility": world.covisibility.edges(), "loops": np.array(world.loop_edges)}


def check_same(world: Map, before: dict[str, np.ndarray]) -> None:
    """Compare with what `contents` gave; only notes about what is to be saved may differ."""
    after = contents(world)
    for name, values in before.items():
        if not name.endswith("is_unsaved"):
            np.testing.assert_array_equal(after[name], values, err_msg=name)


def check_links(world: Map) -> None:
    """Every list of observations holds together, and the counts say what it holds."""
    table, points = world.keypoints, world.points
    for point in range(len(points)):
        rows, row = [], int(points.first_row[point])
        while row >= 0:
            rows.append(row)
            row = int(table.next_row[row])
        assert (table.point[rows] == point).all()
        assert points.n_keyframes[point] == len(rows) == len(set(table.keyframe[rows].tolist()))
        assert points.n_observations[point] == sum(2 if table.right_px[r] >= 0 else 1 for r in rows)
    assert (np.bincount(table.point[table.point >= 0], minlength=len(points)) == points.n_keyframes).all()
