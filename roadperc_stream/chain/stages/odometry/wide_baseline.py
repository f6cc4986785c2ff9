"""Features for a pair of images that optical flow cannot match, as at 2 Hz or in a large turn.

ORB needs no guess and tolerates a change of size. It runs only after optical flow has failed.
"""

from dataclasses import replace

import numpy as np

from roadperc_stream.chain.stages.odometry.features import FRONTENDS, TrackingFrame
from roadperc_stream.chain.stages.odometry.keyframes import Keyframe, LastFrame, make_keyframe
from roadperc_stream.config import OdometryConfig
from roadperc_stream.geometry import Float32


def with_orb(
    cfg: OdometryConfig, keyframe: Keyframe, last: LastFrame, frame: TrackingFrame
) -> tuple[Keyframe, LastFrame, Float32]:
    """The keyframe with ORB features instead of its own, the last frame, and the (N, 2) pixels of their matches.

    The influence of the new features on the last pose is known only if the keyframe is the last frame.
    """
    cfg = cfg.model_copy(update={"features": "orb"})
    key_frame = replace(
        frame, grey=keyframe.grey, movable=keyframe.movable, depth_m=keyframe.depth_m, stamp_ns=keyframe.stamp_ns
    )
    keyframe = make_keyframe(cfg, key_frame, keyframe.odom_T_camera)
    features = keyframe.landmarks.features
    influence = np.zeros((len(features.px), 6)) if last.stamp_ns == keyframe.stamp_ns else None
    px = FRONTENDS["orb"].match(cfg, keyframe.grey, features, features.px, frame.grey)
    return keyframe, replace(last, found_px=features.px, influence=influence), px
