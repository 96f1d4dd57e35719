"""Which points are worth testing at all: the reverse ant colony search (PSPNet-SLAM III.C)."""
