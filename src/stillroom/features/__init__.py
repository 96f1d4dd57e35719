"""Keypoints, and finding them again."""
