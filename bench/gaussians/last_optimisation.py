"""How far the last optimisation of some keyframes is: each in turn, first at half and then at full resolution."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass
class LastOptimisation:
    """The last optimisation of the keyframes ``numbers``: so many iterations of each at half and at full resolution.

    ``neighbours``: keyframes that look at the same place, some of which take turns too, so that what is learned here
    does not stand in their way: one for two of ``numbers``.
    ``seeds``: whether the keyframes add Gaussians before the first iteration at full resolution. ``of_rest``: of all
    that live when no keyframe follows. ``turns``: whose turn it still is in this round.
    """

    numbers: list[int]
    neighbours: list[int]
    coarse_each: int
    fine_each: int
    seeds: bool
    of_rest: bool = False
    done: int = 0
    turns: list[int] = field(default_factory=list)

    @property
    def first_fine(self) -> int:
        """Number of the first iteration at full resolution."""
        return self.coarse_each * (len(self.numbers) + self._guests)

    @property
    def steps(self) -> int:
        """Iterations in all."""
        return self.first_fine + self.fine_each * (len(self.numbers) + self._guests)

    @property
    def _guests(self) -> int:
        """Neighbours that take turns in a round."""
        return min(len(self.neighbours), len(self.numbers) // 2)

    @property
    def over(self) -> bool:
        """Whether all are done."""
        return self.done >= self.steps

    def next(self, random: np.random.Generator) -> tuple[int, bool]:
        """The keyframe of the next iteration, and whether it is drawn at half resolution; it counts as done."""
        if not self.turns:
            guests: list[int] = (
                random.choice(self.neighbours, self._guests, replace=False).tolist() if self._guests else []
            )
            self.turns = random.permutation([*self.numbers, *guests]).tolist()
        half = self.done < self.first_fine
        self.done += 1
        return self.turns.pop(), half
