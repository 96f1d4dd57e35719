"""Where the camera is: from one frame to the next, against the local map, and again after being lost."""
