"""The inputs and results of a frame: frozen dataclasses with read-only arrays."""

from roadperc_stream.geometry.arrays import Ids, Image, Mask, read_only
from roadperc_stream.geometry.planes import HeightGrid as HeightGrid
from roadperc_stream.geometry.planes import PlaneSearch as PlaneSearch
from roadperc_stream.geometry.planes import Surface as Surface
from roadperc_stream.geometry.planes import SurfaceSource as SurfaceSource
from roadperc_stream.model.frame import Frame as Frame
from roadperc_stream.model.inputs import Box as Box
from roadperc_stream.model.inputs import CameraImage as CameraImage
from roadperc_stream.model.inputs import DepthImage as DepthImage
from roadperc_stream.model.inputs import Detection as Detection
from roadperc_stream.model.inputs import InstanceImage as InstanceImage
from roadperc_stream.model.inputs import PointCloud as PointCloud
from roadperc_stream.model.inputs import TagImage as TagImage
from roadperc_stream.model.inputs import Transform as Transform
from roadperc_stream.model.inputs import VideoFrame as VideoFrame
from roadperc_stream.model.reason import MISSING_ROLES as MISSING_ROLES
from roadperc_stream.model.reason import TEMPLATES as TEMPLATES
from roadperc_stream.model.reason import Reason as Reason
from roadperc_stream.model.reason import ReasonKind as ReasonKind
from roadperc_stream.model.reason import StoredReason as StoredReason
from roadperc_stream.model.reason import reason_of as reason_of
from roadperc_stream.model.results import SIDES as SIDES
from roadperc_stream.model.results import Absent as Absent
from roadperc_stream.model.results import Boundary as Boundary
from roadperc_stream.model.results import BoundaryStatus as BoundaryStatus
from roadperc_stream.model.results import Correlation as Correlation
from roadperc_stream.model.results import FrameResult as FrameResult
from roadperc_stream.model.results import LaneChange as LaneChange
from roadperc_stream.model.results import Lanes as Lanes
from roadperc_stream.model.results import Line as Line
from roadperc_stream.model.results import Matches as Matches
from roadperc_stream.model.results import Object as Object
from roadperc_stream.model.results import Objects as Objects
from roadperc_stream.model.results import ObjectStatus as ObjectStatus
from roadperc_stream.model.results import Occupancy as Occupancy
from roadperc_stream.model.results import Odometry as Odometry
from roadperc_stream.model.results import OdometryStatus as OdometryStatus
from roadperc_stream.model.results import PathSource as PathSource
from roadperc_stream.model.results import Side as Side
from roadperc_stream.model.results import StereoDepth as StereoDepth
from roadperc_stream.model.results import Verdict as Verdict
from roadperc_stream.model.sample import (
    EGO,
    ODOM,
    OWN_ODOM,
    UNWRITTEN,
    EarlierTruth,
    FrameAnchor,
    Sample,
    SettledFrame,
    Truth,
)
