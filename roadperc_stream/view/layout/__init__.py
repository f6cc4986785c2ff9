"""Layouts for Foxglove and Lichtblick, with panels for the topics of one log."""
