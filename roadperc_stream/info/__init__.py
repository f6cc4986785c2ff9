"""What is in a log, whether it is whole, and what a replay would make of it: ``roadperc-info``."""
