"""Objects: detections judged by the segmentation, with their distance, followed from frame to frame."""

from roadperc_stream.chain.stages.objects.follow import ObjectsState, step

__all__ = ["ObjectsState", "step"]
