"""Load the map that 01_run_and_score.py made, and look at it from where no camera was."""

import cv2
import numpy as np

import bench

saved = bench.load_map("results/examples/first")
print(f"{len(saved)} Gaussians")

# A pose is T_world_cam: camera to world in metres, x right, y down, z forward. One metre up, and 10 degrees down.
angle = np.deg2rad(-10.0)
shift = np.eye(4)
shift[:3, :3] = [[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]]
shift[1, 3] = -1.0
pose = saved.view_of(4).T_world_cam @ shift

# Without width, height and K it is the run's camera; a PLY file has none, and needs them.
drawn = saved.render(pose)
cv2.imwrite("results/examples/view.png", np.round(255 * drawn.color[..., ::-1]).astype(np.uint8))
print("wrote results/examples/view.png")

# depth is the sum of d a T: divided by alpha it is the mean depth of what is drawn.
solid = drawn.alpha > 0.5
print(f"median depth {np.median(drawn.depth[solid] / drawn.alpha[solid]):.1f} m")
