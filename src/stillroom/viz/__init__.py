"""Pictures: of trajectories, and of what the sieves said of a frame."""
