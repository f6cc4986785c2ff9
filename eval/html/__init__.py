"""One self-contained page over finished runs, for a browser without a network."""
