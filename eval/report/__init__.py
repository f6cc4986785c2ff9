"""The report on runs and on datasets."""
