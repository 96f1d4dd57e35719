"""A method at work: from a name and a camera to poses, what moves, and maps, image by image."""
