"""What a Gaussian map will take, from the images' size and the number of frames."""

from __future__ import annotations

from bench.contracts.mapper import MapNeeds
from bench.gaussians.schema import planes_of

# Gaussians for each pixel of an image: of the first frames, and of every frame on. Between what KITTI 06 and smaller
# images of the street get, which are at first more and later fewer.
_FIRST, _EACH = 0.6, 0.0215
# Metres of a frame, as far as chunks go, and of what lies ahead of the camera and learns.
_FRAME_M, _AHEAD_M = 1.0, 60.0
_FLOAT = 4
# PLY has three normals besides; a checkpoint has Adam's two moments.
_NORMALS, _MOMENTS = 3, 2
# Of a keyframe on disk, for each pixel: image as PNG, depth as float16, sky as a bit.
_KEYFRAME_BYTES = 4.0
# The program with what it imports; what learning holds for each pixel.
_PROGRAM_GB, _PIXEL_BYTES = 0.45, 5500.0


def map_needs(pixels: int, frames: int, sh_degree: int, live_m: float) -> MapNeeds:
    """For images of so many pixels, with every frame a keyframe; what is ``live_m`` metres behind lies on disk."""
    planes = planes_of(sh_degree)

    def gaussians(count: int) -> float:
        return pixels * (_FIRST + _EACH * count)

    live = gaussians(int(min(frames, (live_m + _AHEAD_M) / _FRAME_M)))
    checkpoint = gaussians(frames) * planes * _FLOAT + live * planes * _FLOAT * _MOMENTS
    return MapNeeds(
        map_bytes=gaussians(frames) * (planes + _NORMALS) * _FLOAT,
        checkpoint_bytes=checkpoint + frames * pixels * _KEYFRAME_BYTES,
        memory_gb=_PROGRAM_GB + (pixels * _PIXEL_BYTES + live * planes * _FLOAT * (1 + _MOMENTS)) / 1e9,
    )
