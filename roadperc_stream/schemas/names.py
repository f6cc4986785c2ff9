"""Names of the schemas that more than one module speaks of; what defines them stands in ``registry``."""

from typing import Final

IMAGE_SCHEMA: Final = "foxglove.CompressedImage"
CALIBRATION_SCHEMA: Final = "foxglove.CameraCalibration"
POINTS_SCHEMA: Final = "foxglove.PointCloud"
ROS_IMAGE_SCHEMA: Final = "sensor_msgs/msg/Image"
ROS_GRID_SCHEMA: Final = "nav_msgs/msg/OccupancyGrid"
