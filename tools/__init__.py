"""Makes input logs: converts, renders, degrades, and adds the outputs of networks."""
