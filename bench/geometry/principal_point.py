"""Whether a camera's principal point is that of images of its size: a calibration of another size tells by it."""

from __future__ import annotations

from bench.types import StereoCamera

_BOTH = 0.12
"""Principal point against the image's centre, in both directions to the same side by more than this share of it: the
images are scaled. Of KITTI, KITTI-360, EuRoC, TartanAir and Middlebury none is off by more than 3 % in x and on that
side in y; images at 3/4 size are off by 23 % and more."""
_ONE = 0.5
"""In one direction: cropped or turned images. KITTI-360 is off by 27 % in y, as its images are cropped at the top."""


def doubt_about_size(camera: StereoCamera) -> str | None:
    """One sentence where the principal point does not go with the size of the images, else None."""
    x, y = (2 * at / length - 1 for at, length in ((camera.cx, camera.width), (camera.cy, camera.height)))
    scaled = min(x, y) > _BOTH or max(x, y) < -_BOTH
    if not scaled and max(abs(x), abs(y)) <= _ONE:
        return None
    found = (
        f"the principal point ({camera.cx:g}, {camera.cy:g}) is far from the centre of the images of "
        f"{camera.width}x{camera.height} pixels"
    )
    if scaled:
        times = 1 + (x + y) / 2
        return (
            f"{found}: the calibration seems to be of images about {times:.2g} times as large. Multiply fx, fy, cx, cy "
            "by what the images were resized by, or use the images that it was made for."
        )
    turned = 2 * camera.cx / camera.height - 1, 2 * camera.cy / camera.width - 1
    why = "width and height exchanged" if max(map(abs, turned)) < _ONE else "cropped images, or of another camera"
    return f"{found}: {why}? Use the calibration of these very images."
