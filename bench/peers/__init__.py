"""External SLAM systems in processes of their own: what they crash is a frame, not the run."""
