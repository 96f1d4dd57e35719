"""The voxels of the dense map: found by hash, summed exactly, judged by what depth rays hit and pass."""
