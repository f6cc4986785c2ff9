"""What the chain saw, drawn into the camera image."""
