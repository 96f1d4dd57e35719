"""Masks of what may move: a network's, mended by depth, and carried to the present where the network is late."""
