# Types of the C++ core (bench/native/module.cpp): contiguous CPU tensors or arrays, float32 unless said.
from typing import Any

FIRST_PLANE: dict[str, int]
THRESHOLDS: dict[str, float]
MAX_DEGREE: int
SH_C0: float

def instruction_set() -> str: ...
def threads() -> int: ...
def set_threads(threads: int) -> None: ...
def end_process_in(seconds: float, file: str, content: str, message: str) -> None:
    """End the process with code 1 then, whatever Python does; before that write ``content`` to ``file`` (unless that is
    empty) and ``message`` to standard error. A later call takes the place of an earlier one."""

def end_process_never() -> None: ...

class Workspace:
    def __init__(self) -> None: ...
    def forward(
        self,
        planes: Any,
        T_cam_world: Any,
        fx: float,
        fy: float,
        cx: float,
        cy: float,
        color: Any,
        depth: Any,
        alpha: Any,
    ) -> None: ...
    def observe(
        self,
        planes: Any,
        T_cam_world: Any,
        fx: float,
        fy: float,
        cx: float,
        cy: float,
        pixels: Any,
        median_depth: Any,
    ) -> None: ...
    def backward(
        self,
        planes: Any,
        grad_color: Any,
        grad_depth: Any,
        grad_alpha: Any,
        grads: Any,
        touched: Any,
        pose: bool,
    ) -> list[float]: ...
    def learn(
        self,
        planes: Any,
        grad_color: Any,
        grad_depth: Any,
        grad_alpha: Any,
        params: Any,
        first: Any,
        second: Any,
        position_rate: Any,
        rates: list[float],
        beta1: float,
        beta2: float,
        epsilon: float,
        step: int,
        pose: bool,
    ) -> list[float]: ...
    @property
    def count(self) -> int: ...
    @property
    def visible(self) -> int: ...
    @property
    def bytes(self) -> int: ...

def photometric(
    image: Any,
    target: Any,
    mean: Any,
    variance: Any,
    weight_l1: float,
    weight_l2: float,
    weight_ssim: float,
    grad: Any,
) -> tuple[float, float, float]: ...
def target_statistics(target: Any, mean: Any, variance: Any) -> None: ...
def normal_loss(
    depth: Any,
    alpha: Any,
    covered: float,
    target_normals: Any,
    target_valid: Any,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    weight: float,
    grad_depth: Any,
    add: bool,
) -> float: ...
def smooth_loss(
    depth: Any,
    alpha: Any,
    covered: float,
    distances: list[int],
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    weight: float,
    grad_depth: Any,
    add: bool,
) -> float: ...
def geo_loss(
    depth: Any,
    alpha: Any | None,
    target_depth: Any,
    depth_mask: Any,
    edge_weight: Any | None,
    stride: int,
    weight: float,
    grad_depth: Any,
    grad_alpha: Any | None,
    add: bool,
) -> float: ...
def adam_step(
    params: Any,
    first: Any,
    second: Any,
    grads: Any,
    position_rate: Any,
    rates: list[float],
    beta1: float,
    beta2: float,
    epsilon: float,
    step: int,
    touched: Any,
) -> None: ...

# The tracker's part (bench/native/tracking_bindings.cpp): numpy arrays, float64 and int64 unless said.
class OrbExtractor:
    def __init__(self, features: int, octaves: int, scale_factor: float, threshold: int, tests: Any) -> None: ...
    def extract(self, image: Any) -> tuple[Any, Any, Any, list[Any]]: ...

def bucketed(corners: Any, wanted: int, bucket: int) -> tuple[tuple[int, int, int], ...]: ...
def pair_rows(
    left_xy: Any,
    left_octave: Any,
    left_descriptors: Any,
    right_xy: Any,
    right_octave: Any,
    right_descriptors: Any,
    band: Any,
    nearest_left: float,
    beyond: float,
    max_distance: int,
) -> tuple[Any, Any]: ...
def refine_disparity(left: list[Any], right: list[Any], octave: Any, at_left: Any, x_right: Any) -> tuple[Any, Any]: ...
def match_boxes(
    uv: Any,
    radius: Any,
    octave: Any,
    disparity: Any,
    descriptors: Any,
    keypoint_xy: Any,
    keypoint_octave: Any,
    keypoint_disparity: Any,
    keypoint_descriptors: Any,
    max_distance: int,
    ratio: float,
    octave_tolerance: float,
) -> tuple[Any, Any]: ...
def optimise_pose(
    camera: list[float], points: Any, measured: Any, T_cam_world: Any, rounds: int, iterations: int, gate_first: bool
) -> tuple[Any, Any, float]: ...
def bundle_adjust(
    camera: list[float],
    T_cam_world: Any,
    fixed: int,
    points: Any,
    keyframe: Any,
    point: Any,
    measured: Any,
    iterations: list[int],
) -> tuple[Any, Any, Any]: ...
