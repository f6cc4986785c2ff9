"""Sweeps of settings over logs: the combinations, their replays, and the ranking of their results."""
