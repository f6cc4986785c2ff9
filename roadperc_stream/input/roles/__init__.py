"""Which channel of a log fills which role."""
