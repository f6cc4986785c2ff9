"""Inputs that mean harm: what is promised of them in docs/reliability.md."""
