"""Parts of a feature-based stereo odometry: features, matching, pose, local map, local bundle adjustment."""
