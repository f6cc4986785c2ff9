"""Two runs of the same input against each other: field by field, then metric by metric."""
