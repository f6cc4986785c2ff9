"""Objects: detections filtered by the segmentation, with their distance, tracked from frame to frame."""
