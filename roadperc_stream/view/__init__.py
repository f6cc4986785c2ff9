"""Views of a log: Rerun, Foxglove, video."""
