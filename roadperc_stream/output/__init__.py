"""Writes results: messages, tables, pictures."""
