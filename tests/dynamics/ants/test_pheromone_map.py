"""What the search knows before it sets out."""

import numpy as np

from stillroom.dynamics.ants.search import PheromoneMap, PheromoneMapConfig

EVERYWHERE = np.stack(np.meshgrid(np.arange(0.0, 640, 5), np.arange(0.0, 480, 5)), axis=-1).reshape(-1, 2)


def smells(scent: PheromoneMap, mask: np.ndarray | None = None) -> np.ndarray:
    marked = np.zeros(len(EVERYWHERE), dtype=bool)
    scent.mark(EVERYWHERE, mask, marked)
    return marked


def without_scent(config: PheromoneMapConfig) -> PheromoneMap:
    scent = PheromoneMap(config)
    while smells(scent).any():
        scent.leave(np.zeros((0, 2)))
    return scent


def cells_apart(point: tuple[float, float], cell_px: int) -> np.ndarray:
    return np.abs(EVERYWHERE // cell_px - np.array(point) // cell_px).max(axis=1)


def test_it_smells_around_what_moved_until_it_has_evaporated() -> None:
    scent = without_scent(PheromoneMapConfig(cell_px=20, reach=2, rho=0.5, least=0.2))
    scent.leave(np.array([[310.0, 205.0]]))
    expected = cells_apart((310, 205), 20) <= 2
    for strength in (1.0, 0.5, 0.25, 0.125):
        np.testing.assert_array_equal(smells(scent), expected & (strength >= 0.2))
        scent.leave(np.zeros((0, 2)))


def test_a_mask_smells_at_once_and_leaves_nothing() -> None:
    scent = without_scent(PheromoneMapConfig(cell_px=24, reach=1))
    mask = np.zeros((480, 640), dtype=bool)
    mask[240:250, 480:490] = True
    np.testing.assert_array_equal(smells(scent, mask), cells_apart((480, 240), 24) <= 1)
    assert not smells(scent).any()


def test_on_the_first_images_it_smells_everywhere() -> None:
    scent = PheromoneMap(PheromoneMapConfig(rho=0.5, least=0.4))
    for expected in (True, True, False):
        assert smells(scent).all() == expected
        scent.leave(np.zeros((0, 2)))


def test_off_and_at_the_edge() -> None:
    off = PheromoneMap(PheromoneMapConfig(enabled=False))
    off.leave(EVERYWHERE)
    assert not smells(off, np.ones((480, 640), dtype=bool)).any()
    edge = without_scent(PheromoneMapConfig())
    edge.leave(np.array([[-3.0, -0.2], [9999.0, 9999.0]]))
    assert smells(edge)[0]
    assert smells(edge).sum() < 200
