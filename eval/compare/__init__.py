"""Comparison of two runs of the same input: field by field, then metric by metric."""
