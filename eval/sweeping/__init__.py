"""Every combination of some settings over the same logs: the replays, their dataset, and which setting is best."""
