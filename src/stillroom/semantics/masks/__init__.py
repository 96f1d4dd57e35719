"""Masks of what is potentially dynamic: a network's, refined by depth, and propagated where the network is late."""
