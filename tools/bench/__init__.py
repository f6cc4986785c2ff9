"""Benchmarks; speed is measured as ratios within one run."""
