"""A Gaussian map as PLY in the layout of the original 3DGS code, which splat viewers open."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from plyfile import PlyData, PlyElement

from bench.errors import BenchError
from bench.gaussians.schema import (
    COLOR,
    HARMONICS,
    LOG_SCALE,
    MAX_DEGREE,
    MEAN,
    OPACITY_LOGIT,
    QUATERNION,
    column_names,
    degree_of,
    planes_of,
)
from bench.io.foreign import open_plain, reading

_MOST_HEADER = 65536
"""Bytes; a map with harmonics of degree 3 has 1,500."""

_SKY_COMMENT = "gaussians of the sky, which moves with the viewer: the first "
_ROWS = 1 << 16
"""Gaussians that are written at a time."""

if TYPE_CHECKING:
    from torch import Tensor


def write_ply(path: Path, planes: Tensor, sky: int = 0) -> None:
    """Write (P, N) parameters: positions, zero normals, harmonics, opacity logit, log scales, unit quaternions.

    A comment in the header says that the first ``sky`` of them move with whoever looks at them.
    """
    write_ply_in_parts(path, [planes], planes.shape[1], degree_of(len(planes)), sky)


def write_ply_in_parts(path: Path, parts: Iterable[Tensor], count: int, degree: int, sky: int = 0) -> None:
    """The file that ``write_ply`` writes for all parts (P, N_k) side by side, without a second copy of any of them.

    ``count`` is the sum of all N_k, and ``degree`` that of the harmonics of each; ``BenchError`` where they are not,
    and the file is of no use.
    """
    names = column_names(degree)
    table = np.zeros(_ROWS, dtype=[(name, "<f4") for name in _file_order(names)])
    # Of no rows, for the number is not known to plyfile.
    comments = [f"{_SKY_COMMENT}{sky}"] if sky else []
    header = PlyData([PlyElement.describe(table[:0], "vertex")], byte_order="<", comments=comments).header
    written = 0
    with open(path, "wb") as file:
        file.write(header.replace("element vertex 0\n", f"element vertex {count}\n").encode() + b"\n")
        for part in parts:
            if len(part) != len(names):
                raise BenchError(f"Can't write {path}: a part of the map has {len(part)} planes, not {len(names)}.")
            for data in part.detach().split(_ROWS, dim=1):
                rows = table[: data.shape[1]]
                _fill(rows, names, data.cpu())
                rows.tofile(file)
                written += len(rows)
    if written != count:
        raise BenchError(f"Can't write {path}: the map has {written} Gaussians, and {count} were announced.")


def read_ply(path: Path) -> tuple[Tensor, int]:
    """The (P, N) parameters in a map of any 3DGS program, and how many of the first show the sky; ``BenchError`` for a
    damaged file or one of another kind."""
    data, comments = _vertices(path)
    known = set(data.dtype.names or ())
    harmonics = sum(name.startswith("f_rest_") for name in known)
    degrees = {planes_of(degree) - planes_of(0): degree for degree in range(MAX_DEGREE + 1)}
    if harmonics not in degrees:
        expected = ", ".join(map(str, degrees))
        raise BenchError(f"{path} has {harmonics} columns f_rest_*; a 3DGS map has one of {expected}.")
    names = column_names(degrees[harmonics])
    missing = [name for name in names if name not in known]
    if missing:
        raise BenchError(f"{path} is no 3DGS map: the columns {', '.join(missing)} are missing.")
    # Filled row by row: the file's columns lie interleaved.
    planes = np.empty((len(names), len(data)), np.float32)
    for plane, name in zip(planes, names, strict=True):
        if data.dtype[name].kind not in "fiu":
            raise BenchError(f"{path} is no 3DGS map: its column {name} holds lists and not numbers.")
        plane[:] = data[name]
    bad = np.flatnonzero(~np.isfinite(planes).all(0))
    if len(bad):
        name = names[int(np.flatnonzero(~np.isfinite(planes[:, bad[0]]))[0])]
        raise BenchError(
            f"{path} is damaged: {len(bad)} of {len(data)} Gaussians have values that are no numbers, first {name} "
            f"of Gaussian {bad[0]}. Copy or make the map again."
        )
    said = [comment.removeprefix(_SKY_COMMENT) for comment in comments if comment.startswith(_SKY_COMMENT)]
    sky = said[0] if said and said[0].isdecimal() else "0"
    return torch.from_numpy(planes), min(int(sky[:18]), len(data))


def _fill(rows: np.ndarray, names: tuple[str, ...], data: Tensor) -> None:
    """Put the parameters (P, M) into M rows of the table; its normals stay zero."""
    unit = torch.nn.functional.normalize(data[QUATERNION], dim=0)
    for name, plane in zip((*names, *names[QUATERNION]), (*data, *unit), strict=True):
        rows[name] = plane.numpy()


def _file_order(names: tuple[str, ...]) -> list[str]:
    """The columns in the order in which 3DGS writes them, normals included."""
    rest = sorted(names[HARMONICS], key=lambda name: int(name.removeprefix("f_rest_")))
    last = (*names[COLOR], *rest, names[OPACITY_LOGIT], *names[LOG_SCALE], *names[QUATERNION])
    return [*names[MEAN], "nx", "ny", "nz", *last]


def _vertices(path: Path) -> tuple[np.ndarray, list[str]]:
    """The table of vertices, (N,) with named columns, and the comments of the header."""
    if not path.exists():
        raise BenchError(f"There is no map {path}.")
    with reading(path, "is no PLY file, or damaged", "Copy or make the map again."):
        _require_rows(path)
        ply = PlyData.read(str(path))
        if "vertex" not in ply:
            raise BenchError(f"{path} is no 3DGS map: it has no element 'vertex'.")
        return np.asarray(ply["vertex"].data), list(ply.comments)


def _require_rows(path: Path) -> None:
    """Raise ``ValueError`` for a header that is no PLY's, or says of more rows than the file can have bytes for."""
    with open_plain(path, math.inf) as file:
        header, end, _ = file.read(_MOST_HEADER).partition(b"end_header")
        size = file.seek(0, os.SEEK_END)
    if not (header.startswith(b"ply") and end):
        raise ValueError("it has no header of PLY")
    for count in re.findall(rb"^element\s+\S+\s+(\S+)", header, re.MULTILINE):
        if len(count) > 18 or int(count) > size:
            raise ValueError(f"its header says of {count[:30].decode(errors='replace')} rows, and it has {size} bytes")
