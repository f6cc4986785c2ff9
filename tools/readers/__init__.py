"""Read the files of dumps and datasets, one module for each kind of file."""
