"""Reads finished outputs: reports and comparisons."""
