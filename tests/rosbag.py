"""Writes ROS 2 messages and bags with another library than the one that roadperc_stream reads with."""

import io

from mcap.reader import make_reader
from mcap_ros2.writer import Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

_RULE = "=" * 80 + "\n"
_STORE = get_typestore(Stores.ROS2_HUMBLE)
_HEADER = "MSG: std_msgs/Header\n" + _STORE.generate_msgdef("std_msgs/msg/Header", ros_version=2)[0]
_HYPOTHESIS = "MSG: vision_msgs/ObjectHypothesisWithPose\n"
DETECTIONS_V4 = _RULE.join(
    (
        "std_msgs/Header header\nvision_msgs/Detection2D[] detections\n",
        "MSG: vision_msgs/Detection2D\nstd_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox2D bbox\nstring id\n",
        _HYPOTHESIS + "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n",
        "MSG: vision_msgs/ObjectHypothesis\nstring class_id\nfloat64 score\n",
        "MSG: vision_msgs/BoundingBox2D\nvision_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y\n",
        "MSG: vision_msgs/Pose2D\nvision_msgs/Point2D position\nfloat64 theta\n",
        "MSG: vision_msgs/Point2D\nfloat64 x\nfloat64 y\n",
        "MSG: geometry_msgs/PoseWithCovariance\n"
        + _STORE.generate_msgdef("geometry_msgs/msg/PoseWithCovariance", ros_version=2)[0],
        _HEADER,
    )
)
"""vision_msgs from Humble on."""
DETECTIONS_FOXY = _RULE.join(
    (
        "std_msgs/Header header\nvision_msgs/Detection2D[] detections\n",
        "MSG: vision_msgs/Detection2D\nstd_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox2D bbox\nbool is_tracking\nstring tracking_id\n",
        _HYPOTHESIS + "string id\nfloat64 score\n",
        "MSG: vision_msgs/BoundingBox2D\ngeometry_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y\n",
        "MSG: geometry_msgs/Pose2D\nfloat64 x\nfloat64 y\nfloat64 theta\n",
        _HEADER,
    )
)
"""The layout before Galactic, without the hypotheses' poses."""
DETECTIONS = "vision_msgs/msg/Detection2DArray"


def definition_of(name):
    return DETECTIONS_V4 if name == DETECTIONS else _STORE.generate_msgdef(name, ros_version=2)[0]


class Bag:
    """Writes messages (nested dictionaries) to a stream."""

    def __init__(self, stream):
        self._writer = Writer(stream)
        self._schemas = {}

    def write(self, topic, name, stamp_ns, message, definition=None):
        text = definition or definition_of(name)
        schema = self._schemas.get(name) or self._writer.register_msgdef(name, text)
        self._schemas[name] = schema
        self._writer.write_message(topic, schema, message, log_time=stamp_ns, sequence=0)

    def finish(self):
        self._writer.finish()


def serialised(name, message, definition=None):
    """Bytes of one message."""
    stream = io.BytesIO()
    bag = Bag(stream)
    bag.write("/x", name, 1, message, definition)
    bag.finish()
    stream.seek(0)
    ((_, _, record),) = make_reader(stream).iter_messages()
    return record.data


def header(stamp_ns, frame_id):
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame_id}


def image(stamp_ns, frame_id, encoding, pixels, padding=0):
    """sensor_msgs/msg/Image of an array, with ``padding`` bytes after each row."""
    height, width = pixels.shape[:2]
    rows = pixels.reshape(height, -1)
    row_bytes = [row.tobytes() + b"\xee" * padding for row in rows]
    return {
        "header": header(stamp_ns, frame_id),
        "height": height,
        "width": width,
        "encoding": encoding,
        "is_bigendian": int(pixels.dtype.str.startswith(">")),
        "step": len(row_bytes[0]),
        "data": b"".join(row_bytes),
    }


def camera_info(stamp_ns, frame_id, width, height, K, **other):
    fx, cx, fy, cy = K[0], K[2], K[4], K[5]
    return {
        "header": header(stamp_ns, frame_id),
        "height": height,
        "width": width,
        "distortion_model": "plumb_bob",
        "d": [0.0] * 5,
        "k": list(K),
        "r": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "p": [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        "binning_x": 0,
        "binning_y": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    } | other


def field(name, offset, datatype=7):
    return {"name": name, "offset": offset, "datatype": datatype, "count": 1}


def cloud(stamp_ns, frame_id, rows, padding=0, **other):
    """sensor_msgs/msg/PointCloud2 of (H, W, 4) float32; the last column is padding."""
    height, width = rows.shape[:2]
    return {
        "header": header(stamp_ns, frame_id),
        "height": height,
        "width": width,
        "fields": [field("x", 0), field("y", 4), field("z", 8)],
        "is_bigendian": False,
        "point_step": 16,
        "row_step": 16 * width + padding,
        "data": b"".join(row.tobytes() + b"\xee" * padding for row in rows),
        "is_dense": True,
    } | other


def odometry(stamp_ns, child_frame_id, pose):
    """nav_msgs/msg/Odometry of a geometry_msgs/Pose, standing still."""
    still = {"linear": dict.fromkeys("xyz", 0.0), "angular": dict.fromkeys("xyz", 0.0)}
    return {
        "header": header(stamp_ns, "map"),
        "child_frame_id": child_frame_id,
        "pose": {"pose": pose, "covariance": [0.0] * 36},
        "twist": {"twist": still, "covariance": [0.0] * 36},
    }


def xyz(vector):
    return {"x": vector.x, "y": vector.y, "z": vector.z}


def xyzw(quaternion):
    return xyz(quaternion) | {"w": quaternion.w}


def pose(matrix):
    """A geometry_msgs/Pose of a (4, 4) transform."""
    x, y, z, w = Rotation.from_matrix(matrix[:3, :3]).as_quat().tolist()
    place = dict(zip("xyz", matrix[:3, 3].tolist(), strict=True))
    return {"position": place, "orientation": {"x": x, "y": y, "z": z, "w": w}}


def detection(box, label, score, identity=""):
    """A vision_msgs/Detection2D of Humble around a box with x_min, y_min, x_max, y_max."""
    pose = {"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    center = {"position": {"x": (box.x_min + box.x_max) / 2, "y": (box.y_min + box.y_max) / 2}, "theta": 0.0}
    return {
        "header": header(0, ""),
        "results": [
            {"hypothesis": {"class_id": label, "score": score}, "pose": {"pose": pose, "covariance": [0.0] * 36}}
        ],
        "bbox": {"center": center, "size_x": box.x_max - box.x_min, "size_y": box.y_max - box.y_min},
        "id": identity,
    }
