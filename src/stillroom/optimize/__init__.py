"""Least squares over poses and points; arrays in and out, numba kernels with Python drivers."""
