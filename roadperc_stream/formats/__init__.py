"""How pixels and points are stored in messages and files."""
