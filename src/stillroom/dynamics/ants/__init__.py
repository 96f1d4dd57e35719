"""The reverse ant colony search (PSPNet-SLAM III.C): which points to test for motion."""
