"""Which frames of a data set another system's numbered files and poses are of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from bench.errors import BenchError
from bench.io.frame_names import NamedFiles, in_order
from bench.types import Float

Numbers = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Places:
    """``positions`` (N,) in the data set, -1 where a thing is left out; ``by`` says in words what they were taken for.

    ``by`` is "frame number", "position" or a tolerance in time.
    """

    positions: Numbers
    by: str

    @property
    def left_out(self) -> int:
        """How many things belong to no frame."""
        return int((self.positions < 0).sum())


def in_frame_order(files: Sequence[Path]) -> NamedFiles:
    """Pictures in the order of the number or time in their names; ``BenchError`` for none, and for one number twice."""
    named = in_order(files, "Keep one of them, or give a pattern of names, for example --renders 'FOLDER/gs_*.png'.")
    if named.kind == "name":
        raise BenchError(f"{named.files[0]} has no number in its name, which should have that of its frame. Rename it.")
    return named


def places_of_names(
    named: NamedFiles, frames: Sequence[int], frame_times: Float, mode: str, tolerance_s: float, what: str
) -> Places:
    """Where pictures belong by the time or number in their names; ``BenchError`` where nothing fits.

    Of names with several numbers that differ from file to file the last one counts. ``mode`` as in
    ``places_of_numbers``; with any but "auto" what looks like a time is a number.
    """
    times = named.times
    if times is not None and mode == "auto":
        return places_of_times(times, frame_times, tolerance_s, what)
    try:
        numbers = np.array([int(key[-1]) for key in named.keys], dtype=np.int64)
    except OverflowError:
        raise BenchError(f"{what}: {named.files[-1].name} has too large a number for a frame. Rename it.") from None
    if len(np.unique(numbers)) < len(numbers):
        raise BenchError(f"{what}: the last number is the same in several names. Name the files by their frames alone.")
    return places_of_numbers(numbers, frames, mode, what)


def places_of_numbers(found: Numbers, frames: Sequence[int], mode: str, what: str) -> Places:
    """Where things with these numbers (N,) belong in a data set whose frames have the numbers ``frames``.

    ``mode`` "frame": they are frame numbers, and those of other frames are left out; "position": they count the frames
    from 0; "auto": what fits. ``what`` names them in errors: ``BenchError`` where nothing fits, or both do.
    """
    of_frames = np.array(frames, dtype=np.int64)
    by_frame = _index_in(found, of_frames)
    by_position = np.where((found >= 0) & (found < len(frames)), found, -1)
    if mode == "auto" and not np.array_equal(by_frame, by_position):
        mode = _mode_that_fits(found, of_frames, by_frame, by_position, what)
    if mode == "frame":
        if (by_frame < 0).all():
            raise BenchError(f"{what}: no number is one of the data set's frames {_span(of_frames)}. {_ADVICE}")
        return Places(by_frame, "frame number")
    if (by_position < 0).any():
        wrong = int(found[by_position < 0][0])
        raise BenchError(
            f"{what}: number {wrong} is beyond the data set's {len(frames)} frames {_span(of_frames)}. {_ADVICE}"
        )
    same = np.array_equal(by_frame, by_position)
    return Places(by_position, "frame number" if same and mode == "auto" else "position")


_ADVICE = (
    "Check dataset.sequence and dataset.frames; --numbers frame leaves out what is of other frames, --numbers position "
    "counts the data set's frames from 0."
)


def _mode_that_fits(found: Numbers, frames: Numbers, by_frame: Numbers, by_position: Numbers, what: str) -> str:
    fits_frame, fits_position = bool((by_frame >= 0).all()), bool((by_position >= 0).all())
    if fits_frame and fits_position:
        raise BenchError(
            f"{what}: the numbers {_span(found)} fit the data set's frame numbers {_span(frames)} and its positions "
            f"0 to {len(frames) - 1}. Say --numbers frame or --numbers position."
        )
    if fits_frame:
        return "frame"
    # Where nothing fits, the error is that about positions, which names the first number that is too large.
    return "position"


def places_of_lines(count: int, frames: Sequence[int], mode: str, what: str) -> Places:
    """Where poses without numbers belong, ``count`` of them in order.

    As many as there are frames: one per frame. More, in part of a sequence: line k is frame number k.
    ``mode`` "frame" says that the latter is so, "position" that they are of the first frames. ``BenchError`` otherwise.
    """
    if mode == "auto" and count == len(frames):
        return Places(np.arange(count), "position")
    starts_later = frames[0] != 0 or frames[-1] != len(frames) - 1
    if mode == "frame" or (mode == "auto" and starts_later and count > frames[-1]):
        return places_of_numbers(np.arange(count), frames, "frame", what)
    if mode == "position" and count <= len(frames):
        return Places(np.arange(count), "position")
    more = "more" if count > len(frames) else "fewer"
    advice = (
        "Say --numbers frame if line k is frame k and the data set is part of its sequence"
        if count > len(frames)
        else "Choose the part that the system was run on with dataset.frames=0:N, say --numbers position if the poses "
        "are those of the first frames and the others were lost, or write a TUM file with times"
    )
    raise BenchError(
        f"{what} has {count} poses, {more} than the data set's {len(frames)} frames {_span(np.array(frames))}. "
        f"{advice}."
    )


def places_of_times(times: Float, frame_times: Float, tolerance_s: float, what: str) -> Places:
    """Where poses belong by their ``times`` (N,): to the nearest frame in time within ``tolerance_s``, one to each.

    ``BenchError`` when none is near a frame; it says so when the times look like frame numbers.
    """
    after = np.clip(np.searchsorted(frame_times, times), 1, max(len(frame_times) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(frame_times) - 1)
    nearest = np.where(np.abs(frame_times[after] - times) < np.abs(frame_times[before] - times), after, before)
    apart = np.abs(frame_times[nearest] - times)
    positions = np.full(len(times), -1, dtype=np.int64)
    order = np.lexsort((apart, nearest))
    order = order[apart[order] <= tolerance_s]
    _, first = np.unique(nearest[order], return_index=True)
    positions[order[first]] = nearest[order[first]]
    counted = np.array_equal(times, np.round(times)) and len(times) > 1
    if counted and (positions >= 0).sum() < len(times) and times[-1] > frame_times[-1]:
        raise BenchError(
            f"{what}: its times {times[0]:.0f}, {times[1]:.0f}, ... look like frame numbers, not seconds. Say "
            "--numbers frame (or position), or write times in seconds."
        )
    if (positions < 0).all():
        raise BenchError(
            f"{what}: its times {times[0]:.3f} to {times[-1]:.3f} s are nowhere within {tolerance_s:g} s of the data "
            f"set's frames, {frame_times[0]:.3f} to {frame_times[-1]:.3f} s. Use the data set's clock, say --numbers "
            "if they count frames, or raise --max-time-difference."
        )
    return Places(positions, f"time, within {tolerance_s:g} s")


def _index_in(found: Numbers, frames: Numbers) -> Numbers:
    """Index of each number in the increasing ``frames``, -1 where it is not there."""
    at = np.clip(np.searchsorted(frames, found), 0, len(frames) - 1)
    return np.asarray(np.where(frames[at] == found, at, -1), dtype=np.int64)


def _span(numbers: Numbers) -> str:
    return f"({numbers.min()} to {numbers.max()})"
