"""The roles of input channels, with the default topic and schema of each."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Literal

from roadperc_stream.errors import ChannelError
from roadperc_stream.schemas.topics import CALIBRATION_SCHEMA, IMAGE_SCHEMA, POINTS_SCHEMA, ROS_IMAGE_SCHEMA

Kind = Literal[
    "image",
    "video",
    "tags",
    "instances",
    "depth",
    "points",
    "calibration",
    "detections",
    "tf",
    "pose",
    "surface",
    "lanes",
    "objects",
]


@dataclass(frozen=True)
class Role:
    """The role of an input channel."""

    name: str
    topic: str
    kind: Kind
    schema: str
    """Schema that ``roadperc-convert`` writes."""
    truth: bool = False


ROLES: Final = {
    role.name: role
    for role in (
        Role("image", "/camera/front/image", "image", IMAGE_SCHEMA),
        Role("calibration", "/camera/front/calibration", "calibration", CALIBRATION_SCHEMA),
        Role("depth", "/camera/front/depth", "depth", ROS_IMAGE_SCHEMA),
        Role("depth_calibration", "/camera/front/depth/calibration", "calibration", CALIBRATION_SCHEMA),
        Role("segmentation", "/camera/front/segmentation", "tags", IMAGE_SCHEMA),
        Role("instances", "/camera/front/instances", "instances", IMAGE_SCHEMA),
        Role("detections", "/camera/front/detections", "detections", "roadperc.Detections"),
        Role("left", "/camera/left/image", "image", IMAGE_SCHEMA),
        Role("left_calibration", "/camera/left/calibration", "calibration", CALIBRATION_SCHEMA),
        Role("right", "/camera/right/image", "image", IMAGE_SCHEMA),
        Role("right_calibration", "/camera/right/calibration", "calibration", CALIBRATION_SCHEMA),
        Role("lidar", "/lidar/points", "points", POINTS_SCHEMA),
        Role("tf", "/tf", "tf", "foxglove.FrameTransforms"),
        Role("tf_static", "/tf_static", "tf", "foxglove.FrameTransforms"),
        Role("truth_pose", "/truth/pose", "pose", "foxglove.PoseInFrame", truth=True),
        Role("truth_surface", "/truth/surface", "surface", "roadperc.Surface", truth=True),
        Role("truth_lanes", "/truth/lanes", "lanes", "roadperc.Lanes", truth=True),
        Role("truth_objects", "/truth/objects", "objects", "roadperc.Objects", truth=True),
        Role("truth_depth", "/truth/depth", "depth", ROS_IMAGE_SCHEMA, truth=True),
        Role("truth_segmentation", "/truth/segmentation", "tags", IMAGE_SCHEMA, truth=True),
    )
}

REFERENCE_ROLES: Final = ("image", "left", "depth", "segmentation")
"""Each message of the first of these roles in the log makes one frame."""

LATCHED_KINDS: Final = ("calibration", "tf")
"""Kinds whose messages hold until they are replaced."""
SHARED_KINDS: Final = ("tf",)
"""Kinds whose topic may carry several channels."""
CARLA_BRIDGE: Final = "/carla/"
"""Prefix of the topics of CARLA's ROS bridge."""
CARLA_TOPICS: Final = {
    "image": "rgb_front/image",
    "calibration": "rgb_front/camera_info",
    "depth": "depth_front/image",
    "depth_calibration": "depth_front/camera_info",
    "segmentation": "semantic_segmentation_front/image",
    "instances": "instance_segmentation_front/image",
    "lidar": "lidar",
    "truth_pose": "odometry",
}
"""Topics of CARLA's ROS bridge by role, below ``/carla/VEHICLE/``."""


def parse_topic_options(options: Iterable[str]) -> dict[str, str]:
    """Return the topic of each role in ``role=/topic`` options.

    Raises:
        ChannelError: an option has another form, or its role does not exist.
    """
    mapping = {}
    for option in options:
        role, separator, topic = option.partition("=")
        if not separator or not topic:
            raise ChannelError(f"--topic {option}: expected ROLE=/TOPIC, such as image=/front/rgb")
        require_role(role, f"--topic {option}")
        mapping[role] = topic
    return mapping


def require_role(role: str, where: str) -> None:
    """Check that a role exists.

    ``where`` is the start of the error message.

    Raises:
        ChannelError: it does not exist.
    """
    if role not in ROLES:
        raise ChannelError(f"{where}: no role {role!r}; roles: {', '.join(ROLES)}")
