"""How good a trajectory is, and what it cost: ATE, RPE, coverage, time, memory."""
