"""PSPNet-SLAM's geometry as it is printed: the previous frame's features, projected by a homography and tested."""
