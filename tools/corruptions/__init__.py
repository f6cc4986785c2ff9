"""Corruptions of a log by their published names: of images, of other sensors' contents, and of the messages' order."""
