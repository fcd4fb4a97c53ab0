"""The dialects there are."""

from __future__ import annotations

from bench.evaluation.dialects.dialect import Dialect
from bench.evaluation.dialects.loopsplat import LOOPSPLAT
from bench.evaluation.dialects.monogs import MONOGS
from bench.evaluation.dialects.point_slam import POINT_SLAM
from bench.evaluation.dialects.splatam import SPLATAM

DIALECTS: tuple[Dialect, ...] = (SPLATAM, MONOGS, POINT_SLAM, LOOPSPLAT)
