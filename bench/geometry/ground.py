"""The ground in front of a camera as a plane, fitted to the depth of its image."""

from __future__ import annotations

import numpy as np

from bench.types import Map, PinholeView

_SAMPLES, _TRIALS = 4000, 300
# A pixel lies on the plane where its inverse depth differs by less than this share.
_TOLERANCE = 0.05
# The plane must hold at least this share of the known pixels below the principal point, and its normal must point
# down within 26 degrees.
_LEAST_SHARE, _LEAST_DOWN = 0.3, 0.9


def ground_inverse_depth(depth: Map, view: PinholeView) -> Map | None:
    """Inverse depth (H, W) in 1/m of the ground's plane, not positive above the horizon; None where none is found.

    RANSAC (Fischler and Bolles, 1981) over the depth (H, W) below the principal point, in metres and NaN where
    unknown, then weighted least squares. The same depth gives the same plane. A plane has linear inverse depth:
    1/z = (n . (x, y, 1)) / distance with normalised image coordinates x, y.
    """
    v, u = np.nonzero(np.isfinite(depth))
    low = v > view.cy + 0.1 * view.height
    v, u = v[low], u[low]
    if len(v) < _SAMPLES // 4:
        return None
    random = np.random.default_rng(0)
    chosen = random.choice(len(v), min(len(v), _SAMPLES), replace=False)
    v, u = v[chosen], u[chosen]
    rays = np.stack([(u - view.cx) / view.fx, (v - view.cy) / view.fy, np.ones(len(u))], 1)
    inverse = 1.0 / depth[v, u].astype(np.float64)
    triples = random.integers(0, len(u), (_TRIALS, 3))
    triples = triples[np.abs(np.linalg.det(rays[triples])) > 1e-6]
    planes = np.linalg.solve(rays[triples], inverse[triples][..., None])[..., 0]
    planes = planes[planes[:, 1] > _LEAST_DOWN * np.linalg.norm(planes, axis=1)]
    if not len(planes):
        return None
    modelled = planes @ rays.T
    on_plane = np.abs(modelled - inverse) < _TOLERANCE * modelled
    best = int(on_plane.sum(1).argmax())
    if on_plane[best].mean() < _LEAST_SHARE:
        return None
    plane = planes[best]
    for _ in range(3):
        modelled_here = rays @ plane
        on = np.abs(modelled_here - inverse) < _TOLERANCE * modelled_here
        weight = 1.0 / modelled_here[on]
        plane = np.linalg.lstsq(rays[on] * weight[:, None], inverse[on] * weight, rcond=None)[0]
    x = (np.arange(view.width) - view.cx)[None, :] / view.fx
    y = (np.arange(view.height) - view.cy)[:, None] / view.fy
    return np.asarray(plane[0] * x + plane[1] * y + plane[2], np.float32)
