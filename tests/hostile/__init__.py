"""Tests with hostile inputs, for the rows of docs/reliability.md."""
