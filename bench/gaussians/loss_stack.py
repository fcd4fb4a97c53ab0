"""The weighted sum of a run's loss terms, with its gradients by the rendered images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import torch

from bench.contracts.loss import ImageGradients, LossTerm, NotFiniteError
from bench.contracts.rasterizer import Rendered
from bench.supervision.photometric import Photometric, photometric
from bench.supervision.target import Target

if TYPE_CHECKING:
    from torch import Tensor


class LossStack:
    """Evaluates the terms; all photometric ones in one fused pass."""

    def __init__(self, terms: Sequence[LossTerm]) -> None:
        active = [term for term in terms if term.config.weight != 0.0]
        self._photometric = [term for term in active if term.photometric is not None]
        self._others = [term for term in active if term.photometric is None]
        shares = [[t.config.weight * share for share in t.photometric] for t in self._photometric if t.photometric]
        self._weights = Photometric(*(sum(column) for column in zip(*shares, strict=True)))

    def evaluate(
        self, rendered: Rendered, target: Target
    ) -> tuple[dict[str, float], tuple[Tensor | None, Tensor | None, Tensor | None]]:
        """Unweighted value of each term by name, and the weighted gradients by colour, depth and alpha.

        Outside ``target.color_mask`` the terms see the image itself in place of the render: no error, no gradient.
        ``NotFiniteError`` names the first term that is NaN or infinite.
        """
        values: dict[str, float] = {}
        sums = ImageGradients()
        mask = target.color_mask
        if mask is not None:
            rendered = replace(rendered, color=torch.where(mask, rendered.color, target.image))
        if self._photometric:
            measured, sums.color = photometric(rendered.color, target, self._weights)
            for term in self._photometric:
                assert term.photometric is not None
                values[term.config.name] = measured.weighted(term.photometric)
        for term in self._others:
            values[term.config.name] = term.add_to(sums, rendered, target)
        for name, value in values.items():
            if not math.isfinite(value):
                raise NotFiniteError(
                    f"the loss term {name} is {value}. The map or the term is at fault: see whether it happens without "
                    f"the term (loss.{name}.weight=0), and with lower rates of the mapper."
                )
        if mask is not None and sums.color is not None:
            sums.color *= mask
        return values, (sums.color, sums.depth, sums.alpha)
