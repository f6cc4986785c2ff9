"""Detections and tracks against the true objects, by the measures of public benchmarks."""
