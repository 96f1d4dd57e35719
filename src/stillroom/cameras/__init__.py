"""Cameras that deliver images while they take them. Start reading at `registry.open_camera`."""
