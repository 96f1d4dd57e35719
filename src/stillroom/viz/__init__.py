"""Pictures of trajectories, of maps, and of static and dynamic features in frames."""
