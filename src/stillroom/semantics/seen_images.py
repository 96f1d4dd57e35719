"""Which images a network sees: all, or keyframes only, which are known after they were tracked."""

IMAGES, KEYFRAMES = "images", "keyframes"
SEES = IMAGES, KEYFRAMES
