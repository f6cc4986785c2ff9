"""The rendered world: road, buildings, traffic, camera, truth."""
