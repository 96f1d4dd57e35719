"""Structure and motion from two views of one camera, up to scale: how a monocular map begins."""
