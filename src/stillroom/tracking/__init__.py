"""Tracking: from frame to frame, against the local map, and relocalization."""
