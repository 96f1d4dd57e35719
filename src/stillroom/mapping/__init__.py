"""What a keyframe adds to the map, and what it takes out."""
