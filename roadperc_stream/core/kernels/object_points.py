"""The points of an object in its box, and in which direction the nearest are: compiled, or by numpy with equal bits."""

try:
    from roadperc_stream.core.kernels.object_points_compiled import mean_direction, object_points
except ImportError:
    from roadperc_stream.core.kernels.object_points_plain import mean_direction, object_points

__all__ = ["mean_direction", "object_points"]
