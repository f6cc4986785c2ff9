"""The method of the course *Visual Perception for Self-Driving Cars* (University of Toronto, Coursera), for comparison.

Its steps: drivable surface by RANSAC on road points, lane lines by Canny and Hough on the segmentation, distances of
detections that the segmentation confirms, motion by matched features and perspective from n points, stereo depth.
The code follows the public solutions, with array operations where they are usual. The thresholds of lanes and surface
are those of this project, so that the results agree. It shares no code with the chain.
"""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, Final

import cv2
import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from mcap.reader import make_reader
from numpy.typing import NDArray
from PIL import Image as PillowImage

from roadperc_stream.schemas.roadperc_pb2 import Detections
from roadperc_stream.system.threads import one_thread

Array = NDArray[Any]
FRONT: Final = "/camera/front"
RIGHT: Final = "/camera/right"
ROAD, ROAD_LINE, SIDEWALK = 1, 24, 2
TAG_OF_LABEL: Final = {"Car": 14, "Pedestrian": 12, "Truck": 15, "Bicycle": 19}
RANSAC_ITERATIONS, INLIER_M, DRIVABLE_M = 30, 0.05, 0.15
FARTHEST_ROAD_M, FARTHEST_M = 60.0, 65.5
FULL_ROWS = 960
"""Image height for the lengths in pixels; other heights scale them."""
MIN_SLOPE, MERGE_SLOPE, MERGE_INTERCEPT_PX = 0.3, 0.1, 40.0
MIN_CLASS_RATIO = 0.3
MATCH_RATIO = 0.7


@dataclass(frozen=True)
class CourseFrame:
    """Decoded inputs of a frame: colour, metres, tags, boxes, and the right image of a stereo pair."""

    image: Array
    depth_m: Array
    tags: Array
    detections: list[tuple[str, tuple[int, int, int, int]]]
    right: Array | None


def read_messages(path: Path) -> Iterator[dict[str, bytes]]:
    """Yield the messages of each frame by topic; the first frame includes the calibration."""
    with path.open("rb") as stream:
        of_frame: dict[str, bytes] = {}
        stamp = None
        for _, channel, message in make_reader(stream).iter_messages():
            if stamp is not None and message.log_time != stamp and f"{FRONT}/image" in of_frame:
                yield of_frame
                of_frame = {}
            stamp = message.log_time
            of_frame[channel.topic] = message.data
        if f"{FRONT}/image" in of_frame:
            yield of_frame


def intrinsics(messages: dict[str, bytes]) -> Array:
    """Return (3, 3) K of the front camera."""
    return np.array(CameraCalibration.FromString(messages[f"{FRONT}/calibration"]).K).reshape(3, 3)


def decode(messages: dict[str, bytes]) -> CourseFrame:
    """Decode a frame's messages."""
    image = _colour(messages[f"{FRONT}/image"])
    height, width = image.shape[:2]
    # The pixels of a raw ROS image are its last bytes.
    depth_mm = np.frombuffer(messages[f"{FRONT}/depth"][-2 * height * width :], np.uint16).reshape(height, width)
    segmentation = _content(messages[f"{FRONT}/segmentation"])
    tags = np.array(PillowImage.open(io.BytesIO(segmentation), formats=("PNG",)))
    found = Detections.FromString(messages[f"{FRONT}/detections"]).detections
    sides = ((d.label, d.box_px.x_min, d.box_px.y_min, d.box_px.x_max, d.box_px.y_max) for d in found)
    boxes = [(label, (round(x0), round(y0), round(x1), round(y1))) for label, x0, y0, x1, y1 in sides]
    right = _colour(messages[f"{RIGHT}/image"]) if f"{RIGHT}/image" in messages else None
    return CourseFrame(image, depth_mm / 1000.0, tags, boxes, right)


def _content(message: bytes) -> bytes:
    return bytes(CompressedImage.FromString(message).data)


def _colour(message: bytes) -> Array:
    return np.asarray(cv2.imdecode(np.frombuffer(_content(message), np.uint8), cv2.IMREAD_COLOR))


@dataclass
class Times:
    """CPU time of each part in milliseconds."""

    ms: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def __call__(self, part: str) -> Iterator[None]:
        """Add the CPU time of a block to a part."""
        started = process_time()
        yield
        self.ms[part] = self.ms.get(part, 0.0) + (process_time() - started) * 1000


@dataclass(frozen=True)
class CourseResult:
    """The results of the method in a frame.

    ``plane`` is (a, b, c, d) with a x + b y + c z + d = 0 in metres, ``drivable`` (H, W), ``lines`` (N, 2) slope and
    intercept of y = slope x + intercept in pixels, ``motion`` (4, 4) this_T_before.
    """

    plane: Array
    drivable: Array
    lines: Array
    distances_m: list[float]
    motion: Array | None


def unproject(depth_m: Array, K: Array) -> Array:
    """Return (3, H, W) x, y, z of every pixel, metres."""
    u, v = np.meshgrid(np.arange(depth_m.shape[1]), np.arange(depth_m.shape[0]))
    return np.stack(((u - K[0, 2]) * depth_m / K[0, 0], (v - K[1, 2]) * depth_m / K[1, 1], depth_m))


def plane_of(xyz: Array) -> Array:
    """Return (a, b, c, d) of the least-squares plane through (3, N) points, as in the course."""
    centre = xyz.mean(axis=1)
    centred = xyz - centre[:, np.newaxis]
    normal = np.linalg.svd(centred @ centred.T)[0][:, -1]
    return np.append(normal, -normal @ centre)


def distances(plane: Array, xyz: Array) -> Array:
    """Return the distances of (3, N) points to a plane, metres."""
    return np.asarray(np.abs(plane[:3] @ xyz + plane[3]))


def ransac_plane(xyz: Array, rng: np.random.Generator) -> Array:
    """Return the plane with most inliers among (3, N) points, fitted to the inliers."""
    best: Array = np.zeros(xyz.shape[1], bool)
    for _ in range(RANSAC_ITERATIONS):
        chosen = rng.integers(xyz.shape[1], size=3)
        inliers = distances(plane_of(xyz[:, chosen]), xyz) < INLIER_M
        if inliers.sum() > best.sum():
            best = inliers
    return plane_of(xyz[:, best])


def lane_lines(tags: Array) -> Array:
    """Return (N, 2) slope and intercept of the merged lane lines."""
    scale = tags.shape[0] / FULL_ROWS
    mask = np.where((tags == ROAD_LINE) | (tags == SIDEWALK), 255, 0).astype(np.uint8)
    edges = cv2.Canny(cv2.medianBlur(mask, round(5 * scale) | 1), 100, 150)
    found = cv2.HoughLinesP(
        edges, 2 * scale, np.pi / 180, round(100 * scale), minLineLength=100 * scale, maxLineGap=50 * scale
    )
    if found is None:
        return np.empty((0, 2))
    x1, y1, x2, y2 = found.reshape(-1, 4).T.astype(float)
    slopes = (y2 - y1) / np.where(x2 == x1, 1e-6, x2 - x1)
    intercepts = y1 - slopes * x1
    steep = np.abs(slopes) >= MIN_SLOPE
    return merged(slopes[steep], intercepts[steep], MERGE_INTERCEPT_PX * scale)


def merged(slopes: Array, intercepts: Array, reach_px: float) -> Array:
    """Return the means of groups of lines; a group has nearly the slope and intercept of its first line."""
    groups: list[list[tuple[float, float]]] = []
    for slope, intercept in zip(slopes, intercepts, strict=True):
        for group in groups:
            if abs(group[0][0] - slope) < MERGE_SLOPE and abs(group[0][1] - intercept) < reach_px:
                group.append((slope, intercept))
                break
        else:
            groups.append([(slope, intercept)])
    return np.array([np.mean(group, axis=0) for group in groups]).reshape(-1, 2)


def object_distances(frame: CourseFrame, xyz: Array) -> list[float]:
    """Return the distance of the nearest of (3, H, W) points in each box whose class the segmentation confirms."""
    found = []
    for label, (x0, y0, x1, y1) in frame.detections:
        tags = frame.tags[max(y0, 0) : y1, max(x0, 0) : x1]
        if tags.size and np.mean(tags == TAG_OF_LABEL.get(label)) > MIN_CLASS_RATIO:
            found.append(float(np.linalg.norm(xyz[:, max(y0, 0) : y1, max(x0, 0) : x1], axis=0).min()))
    return found


class VisualOdometry:
    """Motion of the camera between images: SIFT, FLANN with ratio test, perspective from n points."""

    def __init__(self, K: Array) -> None:
        self._K = K
        self._sift = cv2.SIFT.create()
        self._matcher = cv2.FlannBasedMatcher({"algorithm": 1, "trees": 5}, {"checks": 50})
        self._before: tuple[Array, Any, Array] | None = None

    def step(self, image: Array, depth_m: Array) -> Array | None:
        """Return (4, 4) this_T_before; None at the first image, or with too few matches."""
        keypoints, descriptors = self._sift.detectAndCompute(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), None)
        px = np.array([point.pt for point in keypoints]).reshape(-1, 2)
        before, self._before = self._before, (px, descriptors, depth_m)
        if before is None or descriptors is None or before[1] is None:
            return None
        pairs = self._matcher.knnMatch(before[1], descriptors, k=2)
        good = [pair[0] for pair in pairs if len(pair) == 2 and pair[0].distance < MATCH_RATIO * pair[1].distance]
        return self._motion(before, px, good)

    def _motion(self, before: tuple[Array, Any, Array], px: Array, matches: list[cv2.DMatch]) -> Array | None:
        before_px = before[0][[match.queryIdx for match in matches]]
        u, v = before_px.T
        z = before[2][v.round().astype(int), u.round().astype(int)]
        known = (z > 0) & (z < FARTHEST_M)
        points = np.stack(((u - self._K[0, 2]) / self._K[0, 0] * z, (v - self._K[1, 2]) / self._K[1, 1] * z, z), axis=1)
        there = px[[match.trainIdx for match in matches]]
        if known.sum() < 6:
            return None
        found, rotation, translation, _ = cv2.solvePnPRansac(points[known], there[known], self._K, None)
        if not found:
            return None
        motion = np.eye(4)
        motion[:3, :3], motion[:3, 3] = cv2.Rodrigues(rotation)[0], np.ravel(translation)
        return motion


def stereo_depth(left: Array, right: Array, focal_px: float, baseline_m: float) -> Array:
    """Return (H, W) metres by semi-global matching of the colour images at full size."""
    block = 5
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=128,
        blockSize=block,
        P1=8 * 3 * block**2,
        P2=32 * 3 * block**2,
        mode=cv2.StereoSGBM_MODE_SGBM_3WAY,
    )
    disparity = matcher.compute(left, right).astype(np.float32) / 16
    disparity[disparity <= 0] = 0.1
    return np.asarray(focal_px * baseline_m / disparity)


class Course:
    """The method and its state."""

    def __init__(self, messages: dict[str, bytes], times: Times) -> None:
        self._K, self._times = intrinsics(messages), times
        self._odometry = VisualOdometry(self._K)
        self._rng = np.random.default_rng(0)
        self._baseline_m = 0.0
        if f"{RIGHT}/calibration" in messages:
            P = CameraCalibration.FromString(messages[f"{RIGHT}/calibration"]).P
            self._baseline_m = -P[3] / P[0]

    def step(self, messages: dict[str, bytes]) -> CourseResult:
        """Process the messages of one frame."""
        timed = self._times
        with timed("decode"):
            frame = decode(messages)
        with timed("surface"):
            xyz = unproject(frame.depth_m, self._K)
            road = (frame.tags == ROAD) & (frame.depth_m > 0) & (frame.depth_m < FARTHEST_ROAD_M)
            plane = ransac_plane(xyz[:, road], self._rng)
            drivable = (distances(plane, xyz.reshape(3, -1)) < DRIVABLE_M).reshape(frame.tags.shape)
        with timed("lanes"):
            lines = lane_lines(frame.tags)
        with timed("objects"):
            nearest = object_distances(frame, xyz)
        with timed("odometry"):
            motion = self._odometry.step(frame.image, frame.depth_m)
        if frame.right is not None:
            with timed("stereo"):
                stereo_depth(frame.image, frame.right, self._K[0, 0], self._baseline_m)
        return CourseResult(plane, drivable, lines, nearest, motion)


def measure(log: str | Path, frames: int) -> dict[str, float]:
    """Return ms per frame of a log after its first frame: ``cpu``, ``wall``, and CPU time of each part."""
    stream = read_messages(Path(log))
    first = next(stream)
    times = Times()
    course = Course(first, times)
    with one_thread():
        course.step(first)
        times.ms.clear()
        cpu, wall, count = process_time(), perf_counter(), 0
        for messages in islice(stream, frames):
            course.step(messages)
            count += 1
        cpu, wall = process_time() - cpu, perf_counter() - wall
    totals = {"cpu": cpu * 1000, "wall": wall * 1000} | {f"part/{part}": ms for part, ms in times.ms.items()}
    return {name: value / count for name, value in totals.items()}
