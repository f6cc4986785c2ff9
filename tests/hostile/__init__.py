"""Tests with hostile inputs: the promises of docs/reliability.md."""
