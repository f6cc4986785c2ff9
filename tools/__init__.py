"""Makes input logs: converting and rendering dumps."""
