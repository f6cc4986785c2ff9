"""The inputs and results of a frame: frozen dataclasses with read-only arrays."""

from roadperc_stream.geometry.arrays import Ids, Image, Mask, read_only
from roadperc_stream.geometry.planes import HeightGrid, Surface, SurfaceSource
from roadperc_stream.model.frame import (
    Box,
    CameraImage,
    DepthImage,
    Detection,
    Frame,
    InstanceImage,
    PointCloud,
    TagImage,
    Transform,
)
from roadperc_stream.model.reason import MISSING_ROLES, TEMPLATES, Reason, ReasonKind, parse_reason
from roadperc_stream.model.results import (
    SIDES,
    Absent,
    Boundary,
    BoundaryStatus,
    Correlation,
    FrameResult,
    LaneChange,
    Lanes,
    Line,
    Matches,
    Object,
    Objects,
    ObjectStatus,
    Occupancy,
    Odometry,
    OdometryStatus,
    PathSource,
    Side,
    StereoDepth,
    Verdict,
)
from roadperc_stream.model.sample import EGO, ODOM, OWN_ODOM, UNWRITTEN, EarlierTruth, FrameAnchor, Sample, Truth
