"""Every match sieve that can be chosen follows a map that jumps; and the contract notices when one does not."""

import pytest

from stillroom.config.kinds import DYNAMICS
from stillroom.data.map.jumps import JumpFollower
from stillroom.datasets.open import open_dataset
from stillroom.datasets.selection import select
from stillroom.protocols import Dataset
from stillroom.testing.sieve_jumps import FRAMES, WALKING, check_follows_jumps

# Its parallax is between translations of T_cam_world, as in DynaSLAM's code, and so depends on where the world begins.
BY_ORIGIN = "multiview-code"
REMEMBER = ("epipolar", "clusters", "multiview", "compensated-homography", "moved-segments", "chain")


@pytest.fixture(scope="module")
def walk() -> Dataset:
    """Return the contract's own sequence, rendered once."""
    dataset = select(open_dataset(WALKING), FRAMES)
    images = [dataset.load(place) for place in range(len(dataset))]
    dataset.load = images.__getitem__  # type: ignore[method-assign]
    return dataset


@pytest.mark.parametrize("kind", [kind for kind in DYNAMICS.classes if kind != BY_ORIGIN])
def test_follows_a_map_that_jumps(kind: str, walk: Dataset) -> None:
    n_moving = check_follows_jumps(DYNAMICS.classes[kind]().build, walk)
    assert (n_moving > 0) == (kind != "keep-all"), "verdicts that never say anything agree"


@pytest.mark.parametrize("kind", REMEMBER)
def test_the_contract_notices_who_stays_behind(kind: str, walk: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(JumpFollower, "missed", lambda *question: None)
    with pytest.raises(AssertionError, match="after the map jumped at 12, the sieve says otherwise of"):
        check_follows_jumps(DYNAMICS.classes[kind]().build, walk)
