"""Channels that networks compute from a log's images."""
