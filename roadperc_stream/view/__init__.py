"""What people see of a log: Rerun, Foxglove, a video."""
