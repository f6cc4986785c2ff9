"""Visual odometry: features tracked from a keyframe, and the motion estimated from them."""
