"""The row that every table of trajectories needs: what a camera that never moves gets on the same data."""

from __future__ import annotations

from collections.abc import Sequence

from bench.tables.collect import Row

NAME = "static camera"
_SAME = 0.01
"""The grey and the colour camera of one car drive the same path, some centimetres apart: one row serves both."""


def static_camera_rows(rows: Sequence[Row]) -> list[Row]:
    """One row for each data set (and part of it) among the runs, in the order in which they first appear.

    The error is a property of the ground truth. Runs of one data set with equally many frames whose values agree within
    1 % share the first one's row.
    """
    found: list[Row] = []
    for row in rows:
        if row.static_camera is None:
            continue
        n, error = row.static_camera
        values = {"run": NAME, "dataset": row.values.get("dataset"), "frames": f"{n}/{n}", "ate_rmse_m": error}
        new = Row(values, static_camera=row.static_camera, is_reference=True)
        if not any(_is_same(new, known) for known in found):
            found.append(new)
    return found


def _is_same(one: Row, other: Row) -> bool:
    assert one.static_camera is not None
    assert other.static_camera is not None
    (frames, error), (other_frames, other_error) = one.static_camera, other.static_camera
    same_data = one.values["dataset"] == other.values["dataset"] and frames == other_frames
    return same_data and abs(error - other_error) <= _SAME * max(error, other_error)
