"""Estimated and true trajectories: alignment, errors, and files for other tools."""
