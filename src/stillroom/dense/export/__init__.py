"""What comes out of a dense map: point clouds, a mesh, a floor plan for robots, an octree. One file a format."""
