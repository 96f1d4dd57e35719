"""Growing tables: named columns of one length, doubled when full. Views of a column are invalid after a growth."""

from typing import Any, Generic, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

D = TypeVar("D", bound=np.generic)


class Column(Generic[D]):
    """One column of a `Table`: reading it gives a view of the rows in use."""

    def __init__(self, dtype: type[D], *tail: int, fill: float = 0) -> None:
        """Describe a column whose rows have the shape `tail` and start as `fill`."""
        self.dtype, self.tail, self.fill = dtype, tail, fill
        self.name = ""

    def __set_name__(self, owner: type, name: str) -> None:
        """Remember the attribute's name."""
        self.name = name

    @overload
    def __get__(self, table: None, owner: type) -> "Column[D]": ...
    @overload
    def __get__(self, table: "Table", owner: type) -> NDArray[D]: ...
    def __get__(self, table: "Table | None", owner: type) -> "Column[D] | NDArray[D]":
        """Return the rows in use."""
        if table is None:
            return self
        return table.views[self.name]


class Table:
    """Columns declared as class attributes; rows are appended and never removed."""

    def __init__(self, capacity: int = 1024) -> None:
        """Allocate room for `capacity` rows."""
        columns = [value for value in vars(type(self)).values() if isinstance(value, Column)]
        self.columns: tuple[Column[Any], ...] = tuple(columns)
        self.buffers: dict[str, NDArray[Any]] = {
            column.name: np.full((capacity, *column.tail), column.fill, dtype=column.dtype) for column in self.columns
        }
        self.views: dict[str, NDArray[Any]] = {}
        self._length = 0
        self._capacity = capacity
        self._look_again()

    def __len__(self) -> int:
        """Rows in use."""
        return self._length

    def add_column(self, name: str, dtype: type[np.generic], *tail: int, fill: float = 0) -> None:
        """Add a side column, which belongs to the caller; the map itself never reads it.

        Present and later rows start as `fill`. A second call with the same arguments changes nothing.

        Raises:
            ValueError: There is another column of this name.
        """
        column = Column(dtype, *tail, fill=fill)
        column.name = name
        known = next((other for other in self.columns if other.name == name), None)
        if known is not None:
            if known in vars(type(self)).values() or (known.dtype, known.tail, known.fill) != (dtype, tail, fill):
                raise ValueError(f"{type(self).__name__} has another column '{name}' already")
            return
        self.columns = (*self.columns, column)
        self.buffers[name] = np.full((self._capacity, *tail), fill, dtype=dtype)
        self._look_again()

    def column(self, name: str) -> NDArray[Any]:
        """Return the rows in use of a column, side columns among them; the view is invalid after a growth."""
        return self.views[name]

    def append(self, n_rows: int, /, **values: Any) -> slice:
        """Add rows; columns not named keep their fill. Return where they lie."""
        start, stop = self._length, self._length + n_rows
        self._reserve(stop)
        self._length = stop
        for name, value in values.items():
            self.buffers[name][start:stop] = value
        self._look_again()
        return slice(start, stop)

    def _look_again(self) -> None:
        """Make the views once for all readings until the next growth: columns are read some hundred times a frame."""
        self.views = {name: buffer[: self._length] for name, buffer in self.buffers.items()}

    def _reserve(self, n_rows: int) -> None:
        if n_rows <= self._capacity:
            return
        capacity = max(n_rows, 2 * self._capacity)
        for column in self.columns:
            grown = np.full((capacity, *column.tail), column.fill, dtype=column.dtype)
            grown[: self._length] = self.buffers[column.name][: self._length]
            self.buffers[column.name] = grown
        self._capacity = capacity


class KeypointTable(Table):
    """All keypoints of all keyframes, keyframe after keyframe. A row that sees a point is an observation.

    Positions are undistorted pixels; `right_px` is −1 where depth is unknown. `p_static` weighs an observation where
    a sieve gave probabilities. `next_row` links the rows that see one point into a list that starts at the point's
    `first_row`.
    """

    keyframe = Column(np.int32, fill=-1)
    px = Column(np.float32, 2)
    octave = Column(np.int32)
    angle_rad = Column(np.float32)
    right_px = Column(np.float32, fill=-1)
    depth_m = Column(np.float32)
    descriptors = Column(np.uint8, 32)
    is_static = Column(np.bool_, fill=1)
    p_static = Column(np.float32, fill=1)
    point = Column(np.int32, fill=-1)
    next_row = Column(np.int32, fill=-1)


class PointTable(Table):
    """Map points. `n_observations` counts an observation with depth twice, as ORB-SLAM2's limits do.

    `is_unsaved` tells what changed since the map was last written to disk; the writer clears it.
    """

    position_m = Column(np.float64, 3)
    descriptors = Column(np.uint8, 32)
    normal = Column(np.float64, 3)
    min_distance_m = Column(np.float64)
    max_distance_m = Column(np.float64)
    first_row = Column(np.int32, fill=-1)
    n_observations = Column(np.int32)
    n_keyframes = Column(np.int32)
    first_keyframe = Column(np.int32, fill=-1)
    n_visible = Column(np.int32, fill=1)
    n_found = Column(np.int32, fill=1)
    is_alive = Column(np.bool_, fill=1)
    replaced_by = Column(np.int32, fill=-1)
    is_unsaved = Column(np.bool_, fill=1)


class KeyframeTable(Table):
    """Keyframes. A culled one keeps its pose relative to its parent, so that frames that refer to it keep a pose.

    `scale` is what a length around a keyframe has been multiplied by since it was added: only corrections of a map up
    to scale change it. Poses that are noted in a keyframe (`Map.noted_in`) are in lengths as they were then.
    `submap` is the id of its sub-map (see `submaps`); points belong to the sub-map of their first keyframe.
    `is_unsaved` tells of which keyframes the observations changed since the map was last written to disk.
    """

    T_world_cam = Column(np.float64, 4, 4)
    timestamp_s = Column(np.float64)
    image_index = Column(np.int64)
    first_row = Column(np.int64)
    n_rows = Column(np.int64)
    is_alive = Column(np.bool_, fill=1)
    parent = Column(np.int32, fill=-1)
    T_parent_cam = Column(np.float64, 4, 4)
    scale = Column(np.float64, fill=1)
    submap = Column(np.int32)
    is_unsaved = Column(np.bool_, fill=1)
