"""A Gaussian map as PLY in the layout of the original 3DGS code, which splat viewers open."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from plyfile import PlyData, PlyElement
from torch import Tensor

from bench.errors import BenchError
from bench.gaussians.schema import COLOR, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION

_COLUMNS = (
    *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
    *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
)


def write_ply(path: Path, planes: Tensor) -> None:
    """Write (14, N) parameters: positions, degree-0 harmonics, opacity logit, log scales, unit quaternions w x y z."""
    data = planes.detach().cpu()
    quaternions = torch.nn.functional.normalize(data[QUATERNION], dim=0)
    rows = torch.cat(
        [data[MEAN], torch.zeros_like(data[MEAN]), data[COLOR], data[OPACITY_LOGIT][None], data[LOG_SCALE], quaternions]
    )
    table = np.empty(data.shape[1], dtype=[(name, "<f4") for name in _COLUMNS])
    for name, row in zip(_COLUMNS, rows.numpy(), strict=True):
        table[name] = row
    PlyData([PlyElement.describe(table, "vertex")], byte_order="<").write(str(path))


def read_ply(path: Path) -> Tensor:
    """Read a degree-0 map back as (14, N) parameters; raises ``BenchError`` for a file of another layout."""
    vertex = PlyData.read(str(path))["vertex"]
    missing = [name for name in _COLUMNS if name not in vertex.data.dtype.names]
    if missing:
        raise BenchError(f"{path} is no 3DGS map: the columns {', '.join(missing)} are missing.")
    by_name = {name: torch.from_numpy(np.array(vertex[name], np.float32)) for name in _COLUMNS}
    order = ["x", "y", "z", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3", "opacity"]
    return torch.stack([by_name[name] for name in [*order, "f_dc_0", "f_dc_1", "f_dc_2"]])
