"""An estimated path against the true one: alignment, errors, figures and files."""
