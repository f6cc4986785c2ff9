"""Definitions of messages, topics and columns, and the encoding of messages."""
