"""Growing tables."""

import numpy as np
import pytest

from stillroom.data.map.tables import Column, KeyframeTable, KeypointTable, PointTable, Table


class Small(Table):
    number = Column(np.int32, fill=-1)
    place = Column(np.float64, 3)
    flag = Column(np.bool_, fill=1)


@pytest.mark.parametrize("capacity", [1, 2, 7, 1000])
def test_rows_survive_growth_in_their_order(capacity: int) -> None:
    rng = np.random.default_rng(capacity)
    table, numbers, places = Small(capacity), np.zeros(0, np.int32), np.zeros((0, 3))
    for n in [0, 1, 1, 5, 0, 40, 3, 200]:
        new = rng.integers(0, 1000, n).astype(np.int32)
        new_places = rng.random((n, 3))
        where = table.append(n, number=new, place=new_places)
        assert (where.start, where.stop) == (len(numbers), len(numbers) + n)
        numbers, places = np.append(numbers, new), np.vstack((places, new_places))
        assert len(table) == len(numbers)
        np.testing.assert_array_equal(table.number, numbers)
        np.testing.assert_array_equal(table.place, places)
        assert table.flag.all()
        assert table.flag.shape == (len(numbers),)


def test_what_is_written_to_a_column_stays_also_through_growth() -> None:
    table = Small(2)
    table.append(2)
    table.number[1] = 5
    table.place[0] = [1, 2, 3]
    table.flag[0] = False
    table.append(100, number=9)
    assert table.number[:3].tolist() == [-1, 5, 9]
    assert table.place[:2].tolist() == [[1, 2, 3], [0, 0, 0]]
    assert table.flag[:3].tolist() == [False, True, True]
    assert table.number[-1] == 9


def test_two_tables_share_nothing() -> None:
    first, second = Small(4), Small(4)
    first.append(3, number=7)
    assert len(second) == 0
    second.append(3)
    assert second.number.tolist() == [-1, -1, -1]


def test_a_column_that_does_not_exist_is_an_error() -> None:
    with pytest.raises(KeyError):
        Small(4).append(1, numbr=3)


def test_fills_say_nothing_known() -> None:
    keypoints, points, keyframes = KeypointTable(1), PointTable(1), KeyframeTable(1)
    for table in (keypoints, points, keyframes):
        table.append(3)
    assert np.all(keypoints.point == -1)
    assert np.all(keypoints.next_row == -1)
    assert np.all(keypoints.right_px == -1)
    assert keypoints.is_static.all()
    assert np.all(points.first_row == -1)
    assert np.all(points.replaced_by == -1)
    assert points.is_alive.all()
    assert np.all(keyframes.parent == -1)
    assert keyframes.is_alive.all()


def test_a_side_column_grows_along_and_belongs_to_whoever_asked_for_it_alike() -> None:
    table = Small(2)
    table.append(2)
    table.add_column("p_moving", np.float32, fill=0.5)
    table.add_column("votes", np.int32, 2)
    table.column("p_moving")[1] = 0.25
    table.append(100)
    assert table.column("p_moving")[:3].tolist() == [0.5, 0.25, 0.5]
    assert table.column("votes").shape == (102, 2)
    table.add_column("p_moving", np.float32, fill=0.5)
    assert table.column("p_moving")[1] == 0.25
    for name, fill in (("p_moving", 0.0), ("number", -1)):
        with pytest.raises(ValueError, match=f"has another column '{name}' already"):
            table.add_column(name, np.float32, fill=fill)
    assert "votes" not in Small(2).views, "another table knows nothing of it"
