"""XFeat's keypoints and descriptors (see ``xfeat_network``) as features of the tracker."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

from bench.stereo.checkpoint import fit_state, load_state
from bench.stereo.networks.folding import fold_batch_norms
from bench.tracking.descriptors import whole_numbers
from bench.tracking.features import Features, Grey, Pyramid
from bench.tracking.xfeat_network import CELL, MULTIPLE, XFeat, pixel_scores

_LEAST_PROBABILITY, _NEIGHBOURHOOD = 0.05, 5
"""Of a keypoint, and the side in pixels of the square in which its probability is the highest: as published."""
_EPSILON = 1e-5
_ZOOM = 2.0
"""There is one octave; points are matched over 1.5 such steps, so where they are up to 2.8 times as near or as far."""
_SIGMA_PX = 1.5
"""On the built-in street. With 1, right matches are put aside, and most frames look doubtful."""


class XFeatExtractor:
    """The ``count`` keypoints with the best scores, in one octave, at whole pixels (Potje et al., CVPR 2024)."""

    octaves = 1
    scale_factor = _ZOOM
    sigma_px = _SIGMA_PX

    def __init__(self, count: int, weights: Path, device: torch.device) -> None:
        """``weights`` is the published checkpoint; raises ``BenchError`` for a file that is none."""
        self._count, self._device = count, device
        network = XFeat()
        fit_state(network, load_state(weights), weights, ignore=("fine_matcher.",))
        fold_batch_norms(network.eval())
        self._network = network.requires_grad_(False).to(device)

    def extract(self, image: Grey) -> tuple[Features, Pyramid]:
        """Features and the image alone as pyramid, of a grey image (H, W) uint8."""
        image = np.ascontiguousarray(image)
        xy, descriptors, _ = self.describe(image)
        features = Features(xy.astype(np.float64), np.zeros(len(xy), dtype=np.int64), whole_numbers(descriptors))
        return features, Pyramid((image,), np.ones((1, 2)))

    def describe(self, image: Grey) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """Keypoints (N, 2) in pixels, unit descriptors (N, 64), scores (N,), best first.

        Sides that are no multiples of 32 are filled up with their last row and column; the authors' code shrinks the
        image instead, which would shift every keypoint against the camera's intrinsics.
        """
        height, width = image.shape
        with torch.inference_mode(), torch.backends.cudnn.flags(enabled=True, benchmark=False, deterministic=True):
            grey = torch.from_numpy(image).to(self._device)[None, None].float() / 255
            variance, mean = torch.var_mean(grey, correction=0)
            filling = (0, -width % MULTIPLE, 0, -height % MULTIPLE)
            grey = functional.pad((grey - mean) / torch.sqrt(variance + _EPSILON), filling, mode="replicate")
            maps, logits, reliability = self._network(grey)
            xy, probability = _peaks(pixel_scores(logits)[0, 0, :height, :width])
            score = probability * _sampled(reliability, xy, "bilinear")[:, 0]
            best = torch.argsort(score, descending=True, stable=True)[: self._count]
            sampled = _sampled(functional.normalize(maps, dim=1), xy[best], "bicubic")
            found = xy[best], functional.normalize(sampled, dim=1), score[best]
            at, descriptors, scores = (values.cpu().numpy() for values in found)
            return at, descriptors, scores


def _peaks(probability: Tensor) -> tuple[Tensor, Tensor]:
    """Pixels (N, 2), x and y, that are likelier keypoints than their neighbours, and how likely (N,); from (H, W)."""
    highest = functional.max_pool2d(probability[None], _NEIGHBOURHOOD, 1, _NEIGHBOURHOOD // 2)[0]
    row, column = torch.nonzero((probability == highest) & (probability > _LEAST_PROBABILITY), as_tuple=True)
    return torch.stack([column, row], dim=1).float(), probability[row, column]


def _sampled(maps: Tensor, xy: Tensor, mode: str) -> Tensor:
    """Values (N, C) of maps (1, C, H/8, W/8) at pixels (N, 2) of the image.

    Pixel 0 lies on the left edge of the map and the last pixel on the right one, as in training.
    """
    last = torch.tensor((CELL * maps.shape[3] - 1, CELL * maps.shape[2] - 1), device=maps.device)
    at = (2 * xy / last - 1)[None, None]
    return functional.grid_sample(maps, at, mode=mode, align_corners=False)[0, :, 0].T
