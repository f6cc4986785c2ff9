"""The renderer: road, buildings, traffic, cameras and ground truth."""
