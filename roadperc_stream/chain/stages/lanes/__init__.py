"""The ego lane: straight lines in the image, curves on the road, and both boundaries over time."""
