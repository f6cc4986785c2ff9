"""Objects: detections filtered by the segmentation, with their distance, tracked from frame to frame."""

from roadperc_stream.chain.stages.objects.tracker import ObjectsState, step

__all__ = ["ObjectsState", "step"]
