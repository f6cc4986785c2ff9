"""The channel table: which topic fills which role, and which topics the results go to. Knows no mcap."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final, Literal

from roadperc_stream.errors import ChannelError
from roadperc_stream.schemas import ros2
from roadperc_stream.schemas.protobuf import schema_data

Kind = Literal[
    "image", "tags", "depth", "points", "calibration", "detections", "tf", "pose", "surface", "lanes", "objects"
]


@dataclass(frozen=True)
class Role:
    """What an input channel is for."""

    name: str
    topic: str
    kind: Kind
    schema: str
    """Schema that ``roadperc-convert`` writes."""
    truth: bool = False


@dataclass(frozen=True)
class Schema:
    """Name, encoding and definition, as a log stores them."""

    name: str
    message_encoding: str
    schema_encoding: str
    data: bytes


IMAGE_SCHEMA: Final = "foxglove.CompressedImage"
CALIBRATION_SCHEMA: Final = "foxglove.CameraCalibration"
POINTS_SCHEMA: Final = "foxglove.PointCloud"

ROLES: Final = {
    role.name: role
    for role in (
        Role("image", "/camera/front/image", "image", IMAGE_SCHEMA),
        Role("calibration", "/camera/front/calibration", "calibration", CALIBRATION_SCHEMA),
        Role("depth", "/camera/front/depth", "depth", ros2.IMAGE),
        Role("depth_calibration", "/camera/front/depth/calibration", "calibration", CALIBRATION_SCHEMA),
        Role("segmentation", "/camera/front/segmentation", "tags", IMAGE_SCHEMA),
        Role("detections", "/camera/front/detections", "detections", "roadperc.Detections"),
        Role("left", "/camera/left/image", "image", IMAGE_SCHEMA),
        Role("left_calibration", "/camera/left/calibration", "calibration", CALIBRATION_SCHEMA),
        Role("right", "/camera/right/image", "image", IMAGE_SCHEMA),
        Role("right_calibration", "/camera/right/calibration", "calibration", CALIBRATION_SCHEMA),
        Role("lidar", "/lidar/points", "points", POINTS_SCHEMA),
        Role("tf", "/tf", "tf", "foxglove.FrameTransforms"),
        Role("truth_pose", "/truth/pose", "pose", "foxglove.PoseInFrame", truth=True),
        Role("truth_surface", "/truth/surface", "surface", "roadperc.Surface", truth=True),
        Role("truth_lanes", "/truth/lanes", "lanes", "roadperc.Lanes", truth=True),
        Role("truth_objects", "/truth/objects", "objects", "roadperc.Objects", truth=True),
        Role("truth_depth", "/truth/depth", "depth", ros2.IMAGE, truth=True),
        Role("truth_segmentation", "/truth/segmentation", "tags", IMAGE_SCHEMA, truth=True),
    )
}

REFERENCE_ROLES: Final = ("image", "left", "depth", "segmentation")
"""One frame per message of the first of these roles that a log fills."""

PRODUCER: Final = ("producer", "roadperc")
"""Channel metadata by which a later replay knows the results of an earlier one."""
TAG_TABLE_KEY: Final = "tag_table"

RESULTS: Final[Mapping[str, str]] = {
    "/perception/surface": "roadperc.Surface",
    "/perception/drivable": IMAGE_SCHEMA,
    "/perception/drivable/scene": "foxglove.SceneUpdate",
    "/perception/occupancy": ros2.OCCUPANCY_GRID,
    "/perception/lanes": "roadperc.Lanes",
    "/perception/lanes/annotations": "foxglove.ImageAnnotations",
    "/perception/lanes/scene": "foxglove.SceneUpdate",
    "/perception/objects": "roadperc.Objects",
    "/perception/objects/annotations": "foxglove.ImageAnnotations",
    "/perception/stereo/depth": ros2.IMAGE,
    "/perception/odometry": "foxglove.PoseInFrame",
    "/perception/odometry/state": "roadperc.Odometry",
    "/perception/trajectory": "foxglove.PosesInFrame",
    "/perception/tf": "foxglove.FrameTransforms",
    "/perception/metrics": "roadperc.FrameMetrics",
    "/perception/log": "foxglove.Log",
}
"""Result topics and their schemas, in the order in which their channels are registered."""


def schema(name: str) -> Schema:
    """Schema of any message this project writes."""
    if name in ros2.DEFINITIONS:
        return Schema(name, "cdr", "ros2msg", ros2.DEFINITIONS[name])
    return Schema(name, "protobuf", "protobuf", schema_data(name))


def parse_topic_options(options: Iterable[str]) -> dict[str, str]:
    """``role=/topic`` options as a mapping.

    Raises:
        ChannelError: not of that form, or a role that does not exist.

    """
    mapping = {}
    for option in options:
        role, separator, topic = option.partition("=")
        if not separator or not topic:
            raise ChannelError(f"--topic {option}: expected ROLE=/TOPIC, such as image=/front/rgb")
        if role not in ROLES:
            raise ChannelError(f"--topic {option}: no role {role!r}; roles: {', '.join(ROLES)}")
        mapping[role] = topic
    return mapping
