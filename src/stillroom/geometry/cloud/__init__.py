"""Depth clouds as arrays: back-projection, voxel filter, planes, Euclidean clusters, label images."""
