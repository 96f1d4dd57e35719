"""Reads a recording of rerun back, with rerun's own reader."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


class Recorded:
    """What an `.rrd` file holds."""

    def __init__(self, path: Path) -> None:
        from rerun.chunk import RrdReader

        reader = RrdReader(path)
        self.n_blueprints = len(reader.blueprints())
        self._chunks = reader.stream().to_chunks()

    @property
    def entities(self) -> set[str]:
        """Names of what is shown, without the leading slash and rerun's own."""
        return {chunk.entity_path[1:] for chunk in self._chunks if not chunk.entity_path.startswith("/__")}

    def rows(self, entity: str, component: str, timeline: str = "image") -> dict[Any, Any]:
        """Return what a component of an entity was at each time, in order of time."""
        found = []
        for chunk in self._chunks:
            batch = chunk.to_record_batch()
            if chunk.entity_path == f"/{entity}" and {component, timeline} <= set(batch.schema.names):
                times, values = batch.column(timeline), batch.column(component)
                found += [(time.as_py(), value.as_py()) for time, value in zip(times, values, strict=True)]
        return dict(sorted((time, value) for time, value in found if value is not None))

    def last(self, entity: str, component: str) -> NDArray[Any]:
        """Return a component as it was in the end."""
        return np.array(list(self.rows(entity, component).values())[-1])

    def static(self, entity: str, component: str) -> Any:
        """Return a component that is valid at all times."""
        for chunk in self._chunks:
            batch = chunk.to_record_batch()
            if chunk.entity_path == f"/{entity}" and chunk.is_static and component in batch.schema.names:
                return batch.column(component)[0].as_py()
        raise AssertionError(f"{entity} has no {component}")
