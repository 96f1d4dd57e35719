"""The viewer: a run in rerun, in its window or as a file."""
