"""A procedural street: the sequence that needs no download, with exact depth, sky, poses and LiDAR."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.contracts.dataset import Dataset
from bench.errors import BenchError, require_between
from bench.registry import PluginConfig, register
from bench.street.casting import cast, pinhole_rays
from bench.street.lidar import lidar_depth, lidar_points
from bench.street.scene import CHUNK_M, LANE_CENTER_M, build_circuit, build_street
from bench.street.scene import Street as StreetScene
from bench.street.shading import Scene, render
from bench.street.surfaces import SurfaceList, Surfaces
from bench.street.traffic import traffic_surfaces
from bench.street.truck import rear_ahead_m, truck_surfaces
from bench.types import Float, Image, Map, Mask, StereoCamera, StereoFrame, Trajectory

BASELINE_M = 0.54
CAMERA_HEIGHT_M = 1.65
_FOCAL_PER_WIDTH = 0.57
_RATE_HZ = 10.0
_SIZES = ((64, 4096), (32, 4096))
_CIRCUITS_M = (240, 6000)
# On a circuit the car keeps its lane only so well: amplitude and wave length in metres. No two laps are quite the same.
_WANDER_M = 0.2
_WANDER_WAVE_M = 97.0
# Farther ahead or behind, the lorry is left out.
_TRUCK_SEEN_M = 200.0
_JUMPS_PER_FRAME = 0.3
_PAN_DEG = 15.0
_INSTANTS = 8
"""That an open shutter's image is the mean of."""


@dataclass(frozen=True)
class StreetConfig(PluginConfig):
    """Length, size and seed of the drive; and what makes it harder."""

    frames: int = 20
    """Number of frames."""
    width: int = 640
    """Width of the images in pixels."""
    height: int = 192
    """Height of the images in pixels."""
    seed: int = 0
    """Random seed from which the street follows; another one is another street."""
    speed_m: float = 1.0
    """Metres driven per frame."""
    pan_deg: float = 0.0
    """Degrees that the camera turns per frame, to and fro between 15 to the right and 15 to the left."""
    circuit_m: int = 0
    """Length in metres of a closed circuit, driven round and round, a multiple of 30; 0 is an open street."""
    repeated_facades: bool = False
    """Houses and gardens repeat every 30 m to the last pixel; only cars, trees, signs, hills and the ground tell places
    apart."""
    truck: bool = False
    """A lorry overtakes and covers about half of the image."""
    truck_frames: tuple[int, int] = (20, 50)
    """First and last frame in which the lorry stays alongside."""
    traffic: bool = False
    """Two cars drive: one ahead of the camera in its lane, one towards it."""
    exposure_jumps: float = 0.0
    """An automatic exposure, the same in both cameras: every few frames the brightness is another one, times a factor
    of up to 1 plus or minus this share and plus or minus a tenth of it of the full range."""
    texture: float = 1.0
    """Share of the contrast within each surface that is left; 0: one plain colour each, and only outlines, shade and
    clouds show."""
    light: float = 1.0
    """Share of the daylight that is left for the same exposure; 0.05 is dusk."""
    noise: float = 0.0
    """Standard deviation, in grey levels, of the noise that every pixel of every image has of its own."""
    shutter: float = 0.0
    """Share of the time between two frames in which the shutter is open, so that motion blurs; the pose is that of the
    middle. 0 is an instant."""

    def __post_init__(self) -> None:
        if self.frames < 1:
            raise BenchError(f"dataset.frames={self.frames}: the street needs at least 1 frame.")
        for what, value, (low, high) in zip(("width", "height"), (self.width, self.height), _SIZES, strict=True):
            if not low <= value <= high:
                raise BenchError(f"dataset.{what}={value} is out of range; choose {low} to {high} pixels.")
        if not 0.0 <= self.speed_m <= 20.0:
            raise BenchError(f"dataset.speed_m={self.speed_m} is out of range; choose 0 to 20 metres per frame.")
        require_between("dataset", self, 0, 10, "pan_deg")
        if self.seed < 0:
            raise BenchError(f"dataset.seed={self.seed} is negative; choose 0 or more.")
        if not 0 <= self.truck_frames[0] <= self.truck_frames[1]:
            raise BenchError(
                f"dataset.truck_frames={list(self.truck_frames)} must be [first, last] with 0 <= first <= last."
            )
        require_between("dataset", self, 0, 0.9, "exposure_jumps")
        require_between("dataset", self, 0, 1, "texture", "light", "shutter")
        require_between("dataset", self, 0, 50, "noise")
        self._check_circuit()

    def _check_circuit(self) -> None:
        low, high = _CIRCUITS_M
        if self.circuit_m and not low <= self.circuit_m <= high:
            raise BenchError(
                f"dataset.circuit_m={self.circuit_m} is out of range; choose {low} to {high} metres, or 0."
            )
        if self.circuit_m % CHUNK_M:
            nearest = round(CHUNK_M * max(round(self.circuit_m / CHUNK_M), low / CHUNK_M))
            raise BenchError(
                f"dataset.circuit_m={self.circuit_m} is no multiple of {CHUNK_M:.0f} metres, the length of a "
                f"building block; choose {nearest}, for example."
            )


@register("dataset", "street", config=StreetConfig)
class Street(Dataset):
    """Procedural street with exact depth, sky, poses and a simulated 64-beam LiDAR.

    Everything follows from the seed; a longer drive begins with the same frames. The world is the first left camera.
    """

    def __init__(self, config: StreetConfig) -> None:
        options = {
            "circuit": config.circuit_m > 0,
            "repeated": config.repeated_facades,
            "truck": config.truck,
            "traffic": config.traffic,
            "exposure": config.exposure_jumps > 0,
            "pan": config.pan_deg > 0,
            "plain": config.texture < 1,
            "dark": config.light < 1,
            "noise": config.noise > 0,
            "blur": config.shutter > 0,
        }
        self.label = "-".join([f"street/{config.seed}", *(name for name, used in options.items() if used)])
        self.numbers = tuple(range(config.frames))
        focal = _FOCAL_PER_WIDTH * config.width
        self.camera = StereoCamera(
            width=config.width,
            height=config.height,
            fx=focal,
            fy=focal,
            cx=config.width / 2 - 0.5,
            cy=config.height / 2 - 0.5,
            right_position=(BASELINE_M, 0.0, 0.0),
        )
        self._config = config
        self._street: StreetScene = (
            build_circuit(config.seed, config.circuit_m, config.repeated_facades)
            if config.circuit_m
            else build_street(config.seed, config.frames * config.speed_m, config.repeated_facades)
        )

    def frame(self, position: int) -> StereoFrame:
        """Render one pair."""
        config = self._config
        left, right = self._exposed(position) if config.shutter else self._pair(position)
        if config.exposure_jumps or config.light < 1 or config.noise or config.shutter:
            gain, bias = self._exposure(position)
            seen = config.light * gain * np.stack([left, right]) + bias
            if config.noise:
                seen += config.noise * np.random.default_rng((config.seed, position)).standard_normal(seen.shape)
            left, right = np.clip(np.round(seen), 0, 255).astype(np.uint8)
        return StereoFrame(self.numbers[position], position / _RATE_HZ, left, right)

    def _pair(self, position: float) -> tuple[Image, Image]:
        """Left and right image at an instant, ``position`` counted in frames."""
        T = self._pose(position)
        surfaces, s = self._surfaces(position), self._arc_length(position)
        scene = Scene(surfaces, self._street.path, s, self._config.texture)
        return render(self.camera, T, scene), render(self.camera, T @ self.camera.T_left_right, scene)

    def _exposed(self, position: int) -> Float:
        """Both images (2, H, W, 3) as means over the time that the shutter is open."""
        instants = position + self._config.shutter * ((np.arange(_INSTANTS) + 0.5) / _INSTANTS - 0.5)
        return np.mean([self._pair(instant) for instant in instants.tolist()], axis=0)

    def ground_truth(self) -> Trajectory:
        """Exact poses; the first is the identity."""
        T = np.stack([self._pose(position) for position in range(len(self))])
        numbers = np.array(self.numbers, dtype=np.int64)
        return Trajectory(np.linalg.inv(T[0]) @ T, numbers, numbers / _RATE_HZ)

    def true_depth(self, position: int) -> Map:
        """Exact depth at pixel centres, NaN in the sky."""
        inverse = cast(pinhole_rays(self.camera, self._pose(position)), self._surfaces(position)).inverse_range
        with np.errstate(divide="ignore"):
            return np.where(inverse > 0, np.float32(1.0) / inverse, np.float32(np.nan))

    def sensor_depth(self, position: int) -> Map:
        """What a depth camera without noise sees: the exact depth."""
        return self.true_depth(position)

    def true_sky(self, position: int) -> Mask:
        """Exact sky at pixel centres."""
        return np.isnan(self.true_depth(position))

    def lidar_depth(self, position: int) -> Map:
        """Depth at the pixels that see a return of the simulated LiDAR."""
        points = lidar_points(self.camera, self._pose(position), self._surfaces(position))
        return lidar_depth(self.camera, points, self.true_depth(position))

    def _exposure(self, position: int) -> tuple[float, float]:
        """Factor and offset, in grey levels, since the last jump; the drive begins without."""
        if not self._config.exposure_jumps:
            return 1.0, 0.0
        jumps, factors, offsets = np.random.default_rng(self._config.seed).uniform(-1, 1, (position + 1, 3)).T
        jumps[0] = -1
        last = np.flatnonzero(jumps < 2 * _JUMPS_PER_FRAME - 1)[-1]
        share = self._config.exposure_jumps if last else 0.0
        return 1 + share * factors[last], 25.5 * share * offsets[last]

    def _arc_length(self, position: float) -> float:
        return position * self._config.speed_m

    def _surfaces(self, position: float) -> Surfaces:
        """What a camera at this frame may see, the lorry and the traffic included."""
        s, seed, path = self._arc_length(position), self._config.seed, self._street.path
        moving = traffic_surfaces(path, position, seed) if self._config.traffic else SurfaceList()
        ahead = rear_ahead_m(position, self._config.truck_frames)
        if self._config.truck and -_TRUCK_SEEN_M < ahead < _TRUCK_SEEN_M:
            moving.extend(truck_surfaces(path, s + ahead, seed))
        return self._street.seen_from(max(s, 0.0), moving)  # the first frame's shutter opens before the street begins

    def _pose(self, position: float) -> Float:
        """T_street_cam: in its lane, along the street, with a little pitch, roll and heave as of a car."""
        s = self._arc_length(position)
        wander, drift = self._wander(s)
        x, z, heading = self._street.path.beside(s, LANE_CENTER_M + wander)
        heading += drift + self._pan(position)
        pitch, roll = 0.004 * np.sin(0.9 * s), 0.003 * np.sin(0.63 * s + 1.0)
        heave = 0.012 * np.sin(0.75 * s + 0.4)
        T = np.eye(4)
        T[:3, :3] = _rotation(1, heading) @ _rotation(0, pitch) @ _rotation(2, roll)
        T[:3, 3] = (x, -CAMERA_HEIGHT_M + heave, z)
        return T

    def _pan(self, position: float) -> float:
        """How far the camera is turned to the right of where the car drives, in radians; 0 in the first frame."""
        turned = (self._config.pan_deg * position + _PAN_DEG) % (4 * _PAN_DEG)
        return float(np.deg2rad(_PAN_DEG - abs(turned - 2 * _PAN_DEG)))

    def _wander(self, s: float) -> tuple[float, float]:
        """Metres to the right of the lane's middle, and how that turns the car, in radians; zero on an open street."""
        if not self._config.circuit_m:
            return 0.0, 0.0
        phase, wave = 2 * np.pi / _WANDER_WAVE_M * s, 2 * np.pi / _WANDER_WAVE_M
        return _WANDER_M * np.sin(phase), np.arctan(_WANDER_M * wave * np.cos(phase))


def _rotation(axis: int, angle: float) -> Float:
    """Rotation about a coordinate axis by ``angle`` radians."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[i, i] = R[j, j] = np.cos(angle)
    R[i, j], R[j, i] = -np.sin(angle), np.sin(angle)
    return R
