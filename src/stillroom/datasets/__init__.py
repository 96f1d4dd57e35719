"""Sequences from disk (or rendered), behind one socket: `stillroom.protocols.Dataset`."""
