"""Local mapping: new points, fusing, local bundle adjustment, culling."""
