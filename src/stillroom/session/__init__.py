"""A method applied to images: from a name and a camera to poses, moving pixels and maps."""
