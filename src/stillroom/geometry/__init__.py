"""Pure geometry: arrays in, arrays out; knows nothing of frames, maps or files."""
