"""Cameras, rigid transforms, planes, rotations and the road below the car: pure functions on arrays.

Names follow ``a_T_b``: a (4, 4) matrix that maps coordinates in frame b to frame a. Camera frames are optical (x right,
y down, z forward), ego and odom are x forward, y left, z up. Pixel centres are at integers from 0.
"""

from roadperc_stream.geometry.arrays import Float, Float32
from roadperc_stream.geometry.cameras import (
    Camera,
    Lens,
    baseline_of,
    decompose_projection,
    pinhole_fault,
    project,
    rays,
    unproject,
)
from roadperc_stream.geometry.planes import (
    Plane,
    angle_between,
    camera_pitch_roll,
    distance_per_depth,
    facing,
    fit_plane,
    intersect_plane,
    plane_of_scatter,
    transform_plane,
)
from roadperc_stream.geometry.rotations import (
    EGO_R_OPTICAL,
    adjoint,
    inverse,
    mounting,
    rigid,
    transform,
)
