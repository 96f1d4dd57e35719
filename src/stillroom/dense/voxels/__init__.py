"""The voxels of the dense map: hashed, summed exactly, and scored by the depth rays that hit and pass them."""
