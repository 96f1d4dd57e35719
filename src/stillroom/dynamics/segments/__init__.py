"""What does move, told by segments that move against the scene (PSPNet-SLAM III.A, Figure 2)."""
