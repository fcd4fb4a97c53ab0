"""What happened in a run, in order: ``events.jsonl`` for programs, and the same in words for the log."""

from __future__ import annotations

import dataclasses
import json
import logging
from collections.abc import Sequence
from math import inf
from pathlib import Path
from typing import Any

from bench.errors import BenchError
from bench.io.atomic import write_text
from bench.io.foreign import read_plain_text, reading
from bench.types import Event

EVENTS_FILE = "events.jsonl"

log = logging.getLogger(__name__)

_IN_WORDS = {
    "loop_closed": "loop closed: frame {frame} sees the place of frame {to_frame} ({inliers} inliers; {loops_believed} "
    "of {loops} loops believed); {keyframes_moved} of {keyframes} tracker keyframes moved, the farthest by "
    "{farthest_m:.2f} m",
    "lost": "frame {frame}: tracking is lost",
    "predicted": "frame {frame}: the pose is a prediction that the image did not confirm; the frame is not mapped",
    "relocalised": "frame {frame}: the place of frame {to_frame} is recognised; tracking goes on from there",
    "second_motion": "frame {frame}: two motions: by {inliers} points the camera moved {moved_m:.2f} m, by "
    "{other_inliers} others {other_moved_m:.2f} m; believed are the first, which agree with what has stood still",
    "map_moved": "the map follows corrected poses: {keyframes} keyframes with {gaussians} Gaussians move by up to "
    "{largest_m:.3f} m and {largest_deg:.3f} degrees",
    "pruned": "frame {frame}: {count} Gaussians pruned",
    "chunk_frozen": "frame {frame}: the map of keyframes {first} to {last} is done and on disk",
    "warning": "{text}",
    "no_depth": "frame {frame}: {source} knows no depth at all",
}
"""The kinds of events that the project itself makes, with their values."""

# Corrections below this come with nearly every keyframe, and go to the log's finest level.
_WORTH_TELLING_M, _WORTH_TELLING_DEG = 0.05, 2.86


def tell(event: Event) -> None:
    """Say in the log what happened; the one place where an event becomes a sentence."""
    log.log(_level(event), "%s", in_words(event))


def in_words(event: Event) -> str:
    """A sentence for people; of a kind or with values that are not the project's own, the values by name."""
    try:
        return _IN_WORDS[event.kind].format_map({**event.values, "frame": event.frame})
    except (KeyError, ValueError):
        values = ", ".join(f"{name} {value}" for name, value in event.values.items())
        return f"frame {event.frame}: {event.kind}" + (f" ({values})" if values else "")


def _level(event: Event) -> int:
    small_move = event.kind == "map_moved" and (
        event.values.get("largest_m", inf) <= _WORTH_TELLING_M
        and event.values.get("largest_deg", inf) <= _WORTH_TELLING_DEG
    )
    if small_move or event.kind in ("pruned", "chunk_frozen"):
        return logging.DEBUG
    return logging.WARNING if event.kind in ("lost", "predicted", "warning", "no_depth") else logging.INFO


def check_events(events: Sequence[Event], what: str) -> None:
    """Raise ``BenchError`` for an event whose values are no plain data; ``what`` names the method that gave it."""
    for event in events:
        try:
            _as_line(event)
        except (TypeError, ValueError) as error:
            raise BenchError(
                f"{what} gave an event '{event.kind}' of frame {event.frame} with values {event.values}; expected "
                f"plain data: finite numbers, text, and lists and dicts of them (of numpy's, their .item()). {error}"
            ) from error


def write_events(folder: Path, events: Sequence[Event]) -> None:
    """Write ``events.jsonl`` into a run folder, whole or not at all: one JSON object per event."""
    write_text(folder / EVENTS_FILE, "".join(_as_line(event) + "\n" for event in events))


def read_events(folder: Path) -> list[Event]:
    """The events of a run folder, none where no such file lies; raises ``BenchError`` for a damaged one."""
    path = folder / EVENTS_FILE
    if not path.is_file():
        return []
    with reading(path, "is damaged", "Delete it and run again."):
        return [_event(json.loads(line)) for line in read_plain_text(path).splitlines()]


def _event(content: Any) -> Event:
    event = Event(**content)
    if not (isinstance(event.kind, str) and isinstance(event.frame, int) and isinstance(event.values, dict)):
        raise TypeError(f"{str(content)[:80]} is no event")
    return event


def _as_line(event: Event) -> str:
    return json.dumps(dataclasses.asdict(event), allow_nan=False)
