"""Scenes for the stages, without a log or a chain around them."""

import numpy as np

from roadperc_stream.model.frame import Frame
from roadperc_stream.model.tag_tables import CARLA_BEFORE_0_9_14 as TABLE


def scene_of(camera, ego_T_camera=None, *, depth_m=None, limit_m=np.inf, source="depth", stamp_ns=1, **inputs):
    """A scene of the front camera, to which the depth belongs; the tags are those of CARLA before 0.9.14."""
    ego_T_camera = np.eye(4) if ego_T_camera is None else ego_T_camera
    depth = {} if depth_m is None else {"raw_depth_m": depth_m, "depth_limit_m": limit_m, "depth_source": source}
    return Frame.of(stamp_ns, camera, ego_T_camera, **{"table": TABLE, **depth, **inputs})
