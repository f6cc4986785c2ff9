"""Read a dump folder: find its files, read their contents, and make messages of them."""
