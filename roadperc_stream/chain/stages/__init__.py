"""The stages of the chain: pure functions that do not depend on each other."""
