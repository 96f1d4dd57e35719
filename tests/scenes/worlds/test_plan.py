"""Which cells are seen: against looking along very many straight lines."""

import numpy as np
import pytest

from stillroom.geometry.camera import Camera
from stillroom_scenes.camera_path import looking
from stillroom_scenes.worlds.plan import Cell, Opening, Plan

CAMERA = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
# Two rooms, a corridor below them, a closet behind the second room; doors of a metre.
CELLS = (
    Cell("corridor", (0.0, 0.0), (10.0, 2.0)),
    Cell("left", (0.0, 2.0), (5.0, 6.0)),
    Cell("right", (5.0, 2.0), (10.0, 6.0)),
    Cell("closet", (10.0, 4.0), (12.0, 6.0)),
    Cell("annex", (10.0, 0.0), (14.0, 2.0)),
)
OPENINGS = (
    Opening((0, 1), (1.0, 2.0), (2.0, 2.0)),
    Opening((0, 2), (8.0, 2.0), (9.0, 2.0)),
    Opening((2, 3), (10.0, 4.5), (10.0, 5.5)),
    Opening((0, 4), (10.0, 0.0), (10.0, 2.0)),
)
STEP_M = 0.01


def walked(plan: Plan, x_m: float, y_m: float, angles: np.ndarray) -> set[int]:
    """Go along straight lines in small steps; a line ends where it leaves a cell other than through an opening."""
    found = set()
    for angle in angles:
        position, step = np.array([x_m, y_m]), STEP_M * np.array([np.cos(angle), np.sin(angle)])
        cell = plan.cell_at(x_m, y_m)
        for _ in range(2000):
            found.add(cell)
            position = position + step
            if plan.cells[cell].distance_m(*position) == 0.0:
                continue
            doors = [o for o in plan.openings if cell in o.cells and o.distance_m(*position) < 1.5 * STEP_M]
            if not doors:
                break
            cell = doors[0].beyond(cell)
    return found


@pytest.mark.parametrize("seed", range(3))
def test_no_cell_that_a_straight_line_reaches_is_left_out(seed: int) -> None:
    plan = Plan(CELLS, OPENINGS)
    rng = np.random.default_rng(seed)
    sizes = []
    for _ in range(6):
        cell = CELLS[int(rng.integers(len(CELLS)))]
        low, high = np.array(cell.low_m) + 0.35, np.array(cell.high_m) - 0.35
        x, y = rng.uniform(low, high)
        yaw, pitch = rng.uniform(-np.pi, np.pi), rng.uniform(-0.2, 0.2)
        pose = looking(np.array([[x, y, 1.4]]), np.array([yaw]), np.array([pitch]), np.array([0.0]))[0]
        half = np.arctan2(0.5 * CAMERA.width, CAMERA.fx)
        lines = walked(plan, x, y, yaw + np.pi / 2 + np.linspace(-half, half, 101))
        seen = set(plan.seen(CAMERA, pose))
        assert lines <= seen, (cell.name, [CELLS[k].name for k in lines - seen])
        sizes.append(len(seen))
    assert min(sizes) < len(CELLS), "everything is seen from everywhere"


def test_what_lies_behind_a_wall_or_the_camera_is_not_seen() -> None:
    plan = Plan(CELLS, OPENINGS)

    def seen(x: float, y: float, heading: float) -> set[str]:
        yaw = np.array([heading - np.pi / 2])
        pose = looking(np.array([[x, y, 1.4]]), yaw, np.zeros(1), np.zeros(1))[0]
        return {CELLS[k].name for k in plan.seen(CAMERA, pose)}

    assert seen(2.5, 4.0, np.pi / 2) == {"left"}
    assert seen(5.0, 1.0, 0.0) == {"corridor", "annex", "right"}
    assert seen(5.0, 1.0, np.pi) == {"corridor", "left"}
    assert seen(7.0, 5.0, 0.0) == {"right", "closet"}
    assert seen(7.0, 5.0, np.pi) == {"right"}
    assert seen(8.5, 1.0, np.pi / 2) == {"corridor", "right", "closet"}
    assert seen(8.7, 1.0, np.pi * 0.6) == {"corridor", "right"}
    straight_down = np.eye(4)
    straight_down[:3, :3] = np.diag([1.0, -1.0, -1.0])
    straight_down[:3, 3] = 8.5, 1.9, 1.4
    assert "right" in {CELLS[k].name for k in plan.seen(CAMERA, straight_down)}
