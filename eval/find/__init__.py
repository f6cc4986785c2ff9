"""Events that fulfil a condition, and excerpts of their logs."""
