"""Pictures of geometry at work: the compensated image, what moves against it, and the ants' path."""
