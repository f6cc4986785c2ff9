"""A batch's dataset: its list of runs, and statistics over all its tables in one pass."""
