"""Runs against absolute limits."""
