"""What does move, told by clusters of the depth cloud (OC-SLAM 2.3–2.5)."""
