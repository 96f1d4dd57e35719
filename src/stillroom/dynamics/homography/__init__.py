"""Dynamic points by an optimally compensated homography, with depth for its parallax (PSPNet-SLAM III.B)."""
