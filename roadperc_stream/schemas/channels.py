"""The channel table: which topic fills which role, and which topics the results go to. Knows no mcap."""

from collections.abc import Collection, Iterable, Mapping
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
    elsewhere: tuple[str, ...] = ()
    """Topics of other recorders, ``*`` standing for any one name: here those of CARLA's ROS bridge."""


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
        Role("image", "/camera/front/image", "image", IMAGE_SCHEMA, elsewhere=("/carla/*/rgb_front/image",)),
        Role(
            "calibration",
            "/camera/front/calibration",
            "calibration",
            CALIBRATION_SCHEMA,
            elsewhere=("/carla/*/rgb_front/camera_info",),
        ),
        Role("depth", "/camera/front/depth", "depth", ros2.IMAGE, elsewhere=("/carla/*/depth_front/image",)),
        Role(
            "depth_calibration",
            "/camera/front/depth/calibration",
            "calibration",
            CALIBRATION_SCHEMA,
            elsewhere=("/carla/*/depth_front/camera_info",),
        ),
        Role(
            "segmentation",
            "/camera/front/segmentation",
            "tags",
            IMAGE_SCHEMA,
            elsewhere=("/carla/*/semantic_segmentation_front/image",),
        ),
        Role("detections", "/camera/front/detections", "detections", "roadperc.Detections"),
        Role("left", "/camera/left/image", "image", IMAGE_SCHEMA),
        Role("left_calibration", "/camera/left/calibration", "calibration", CALIBRATION_SCHEMA),
        Role("right", "/camera/right/image", "image", IMAGE_SCHEMA),
        Role("right_calibration", "/camera/right/calibration", "calibration", CALIBRATION_SCHEMA),
        Role("lidar", "/lidar/points", "points", POINTS_SCHEMA, elsewhere=("/carla/*/lidar",)),
        Role("tf", "/tf", "tf", "foxglove.FrameTransforms"),
        Role("tf_static", "/tf_static", "tf", "foxglove.FrameTransforms"),
        Role(
            "truth_pose",
            "/truth/pose",
            "pose",
            "foxglove.PoseInFrame",
            truth=True,
            elsewhere=("/carla/*/odometry",),
        ),
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
"""Names the table of a channel's tags: in the channel's metadata, or, where its recorder did not, in a result's record
of how it came about."""
METADATA_RECORD: Final = "roadperc"
"""Metadata record of a result: how it came about."""
CONFIG_ATTACHMENT: Final = "roadperc.toml"
"""Attachment of a result: the whole configuration."""
TOPIC_KEY: Final = "topic."
"""Keys of that record which begin so name a role, and the topic that was chosen for it."""
CARLA_BRIDGE: Final = "/carla/"
"""How the topics of CARLA's ROS bridge begin."""

METRICS_TOPIC: Final = "/perception/metrics"
"""Of each frame's row."""
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
    "/perception/objects/scene": "foxglove.SceneUpdate",
    "/perception/stereo/depth": ros2.IMAGE,
    "/perception/odometry": "foxglove.PoseInFrame",
    "/perception/odometry/state": "roadperc.Odometry",
    "/perception/trajectory": "foxglove.PosesInFrame",
    "/perception/tf": "foxglove.FrameTransforms",
    METRICS_TOPIC: "roadperc.FrameMetrics",
    "/perception/log": "foxglove.Log",
}
"""Result topics and their schemas, in the order in which their channels are registered."""

Request = Literal["overlay", "debug"]
ON_REQUEST: Final[Mapping[str, Request]] = {
    "/perception/overlay": "overlay",
    "/perception/debug/lanes": "debug",
    "/perception/debug/matches": "debug",
    "/perception/debug/template": "debug",
    "/perception/debug/disparity": "debug",
}
"""Topics of pictures, foxglove.CompressedImage all, that are made only where somebody asks for them, and for what."""

LIVE_ONLY: Final[Mapping[str, str]] = {"/perception/times": "roadperc.StageTimes"}
"""Topics that a live server adds to those of the log: a log of the same input is the same bytes every time, and the
times of its stages are not."""


def result_schemas(requests: Collection[Request]) -> dict[str, str]:
    """Topics and schemas of a replay's results, those on request among them."""
    return dict(RESULTS) | {topic: IMAGE_SCHEMA for topic, request in ON_REQUEST.items() if request in requests}


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
