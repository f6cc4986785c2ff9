"""Results as pictures: annotations for the viewers, and overlays drawn into the camera image."""
