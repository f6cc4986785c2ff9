"""The perception chain of one frame: the step, and the stages it runs."""
