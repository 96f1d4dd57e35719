"""Keypoints, their matching and tracking, and place recognition."""
