"""Loop closing and sub-map merging: detection, verification, correction of the map."""
