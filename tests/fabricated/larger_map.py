"""Makes a map large at once: copies of all that is in it, far away, where no frame of the present place sees them."""

import numpy as np

from stillroom.data.map import Map

APART_M = 1000.0


def add_far_copies(world: Map, count: int) -> None:
    """Append so many copies of a map to itself, each a kilometre further along x, with links and covisibility."""
    tables = (world.keyframes, world.keypoints, world.points)
    one = [{column.name: np.array(getattr(table, column.name)) for column in table.columns} for table in tables]
    sizes, edges = [len(table) for table in tables], world.covisibility.edges()
    all_edges = [edges]
    for n in range(1, count + 1):
        first_keyframe, first_row, first_point = (len(table) for table in tables)
        keyframes, rows, points = ({name: column.copy() for name, column in table.items()} for table in one)
        keyframes["first_row"] += first_row
        keyframes["parent"] = np.where(keyframes["parent"] >= 0, keyframes["parent"] + first_keyframe, 0)
        keyframes["T_world_cam"][:, 0, 3] += APART_M * n
        rows["keyframe"] += first_keyframe
        for name, offset in (("point", first_point), ("next_row", first_row)):
            rows[name] = np.where(rows[name] >= 0, rows[name] + offset, -1)
        points["first_keyframe"] += first_keyframe
        points["position_m"][:, 0] += APART_M * n
        for name, offset in (("first_row", first_row), ("replaced_by", first_point)):
            points[name] = np.where(points[name] >= 0, points[name] + offset, -1)
        for table, size, columns in zip(tables, sizes, (keyframes, rows, points), strict=True):
            table.append(size, **columns)
        all_edges.append(edges + np.array([first_keyframe, first_keyframe, 0], dtype=np.int32))
    world.covisibility.restore(np.concatenate(all_edges))
