"""The tables and figures of OC-SLAM and PSPNet-SLAM, made again: `stillroom bench paper`."""
