"""What a search may vary: each override with several values, as a distribution of Optuna's."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from hydra.core.override_parser.types import IntervalSweep, Override, RangeSweep
from hydra.errors import HydraException

from bench.config import check_overrides, compose_run
from bench.errors import BenchError, first_line
from bench.override_text import hydra_lines
from bench.sweeps.combinations import expand_globs
from bench.sweeps.experiment import table_experiments

if TYPE_CHECKING:
    from optuna.distributions import BaseDistribution


def split_space(overrides: Sequence[str]) -> tuple[list[str], dict[str, BaseDistribution]]:
    """The overrides that all runs share, and a distribution for each that names several values, by its setting.

    ``interval(a,b)`` is continuous, or whole numbers where the setting is one; ``tag(log,interval(a,b))`` logarithmic;
    ``range(a,b,step)`` equal steps; ``a,b`` and ``choice(a,b)`` any of them. Raises ``BenchError`` without any, and for
    an empty or wrong one.
    """
    if of_tables := table_experiments(overrides):
        raise BenchError(f"{of_tables[0]}: a search varies settings, not the rows of a table. Leave it out.")
    fixed, varied = [], []
    for parsed in check_overrides(expand_globs(hydra_lines(overrides))[0]):
        if not parsed.is_sweep_override():
            fixed.append(parsed.input_line or "")
        elif parsed.key_or_group in ("seed", "output"):
            raise BenchError(f"{parsed.input_line}: a search does not vary {parsed.key_or_group}. Give one value.")
        else:
            varied.append(parsed)
    if not varied:
        raise BenchError("A search needs something to vary, such as 'mapper.iterations=interval(5,50)' or stereo=a,b.")
    values = compose_run(fixed).values
    return fixed, {parsed.get_key_element(): _distribution(parsed, values) for parsed in varied}


def _distribution(parsed: Override, values: Mapping[str, Any]) -> BaseDistribution:
    from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

    try:
        sweep = parsed.value()
        if isinstance(sweep, IntervalSweep):
            low, high, log = float(sweep.start or 0), float(sweep.end or 0), "log" in sweep.tags
            if _is_whole(values, parsed.key_or_group):
                return IntDistribution(math.ceil(low), math.floor(high), log=log)
            return FloatDistribution(low, high, log=log)
        if isinstance(sweep, RangeSweep):
            # As one writes them: not 0.30000000000000004.
            steps = sorted(round(each, 12) for each in sweep.range())
            step = round(steps[1] - steps[0], 12) if len(steps) > 1 else 1
            if all(isinstance(each, int) for each in steps):
                return IntDistribution(steps[0], steps[-1], step=step)
            return FloatDistribution(steps[0], steps[-1], step=step)
        return CategoricalDistribution(list(parsed.sweep_string_iterator()))
    except (ValueError, IndexError, HydraException) as error:
        raise BenchError(
            f"{parsed.input_line}: {first_line(error)}. Write interval(LOW,HIGH) or values with commas."
        ) from error


def _is_whole(values: Any, key: str) -> bool:
    for part in key.split("."):
        values = values.get(part) if isinstance(values, Mapping) else None
    return isinstance(values, int) and not isinstance(values, bool)
