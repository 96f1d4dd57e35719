"""Many frames in one file: as a video, or side by side."""
