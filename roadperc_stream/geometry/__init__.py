"""Cameras, rigid transforms, planes, rotations and the road below the car: pure functions on arrays.

Names follow ``a_T_b``: a (4, 4) matrix that maps coordinates in frame b to frame a. Camera frames are optical (x right,
y down, z forward), ego and odom are x forward, y left, z up. Pixel centres are at integers from 0.
"""

from roadperc_stream.geometry.arrays import Float as Float
from roadperc_stream.geometry.arrays import Float32 as Float32
from roadperc_stream.geometry.cameras import Camera as Camera
from roadperc_stream.geometry.cameras import Lens as Lens
from roadperc_stream.geometry.cameras import baseline_of as baseline_of
from roadperc_stream.geometry.cameras import decompose_projection as decompose_projection
from roadperc_stream.geometry.cameras import inside_image as inside_image
from roadperc_stream.geometry.cameras import pinhole_fault as pinhole_fault
from roadperc_stream.geometry.cameras import project as project
from roadperc_stream.geometry.cameras import rays as rays
from roadperc_stream.geometry.cameras import unproject as unproject
from roadperc_stream.geometry.planes import Plane as Plane
from roadperc_stream.geometry.planes import angle_between as angle_between
from roadperc_stream.geometry.planes import camera_pitch_roll as camera_pitch_roll
from roadperc_stream.geometry.planes import distance_per_depth as distance_per_depth
from roadperc_stream.geometry.planes import facing as facing
from roadperc_stream.geometry.planes import fit_plane as fit_plane
from roadperc_stream.geometry.planes import intersect_plane as intersect_plane
from roadperc_stream.geometry.planes import transform_plane as transform_plane
from roadperc_stream.geometry.rotations import EGO_R_OPTICAL as EGO_R_OPTICAL
from roadperc_stream.geometry.rotations import adjoint as adjoint
from roadperc_stream.geometry.rotations import inverse as inverse
from roadperc_stream.geometry.rotations import is_rotation as is_rotation
from roadperc_stream.geometry.rotations import mounting as mounting
from roadperc_stream.geometry.rotations import rigid as rigid
from roadperc_stream.geometry.rotations import transform as transform
