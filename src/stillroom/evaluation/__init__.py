"""Evaluation: ATE, RPE, coverage, ghosts, time and memory."""
