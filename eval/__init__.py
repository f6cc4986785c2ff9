"""Evaluates finished runs: reports, comparisons, checks and scores."""
