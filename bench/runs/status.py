"""The state of a run, kept in ``status.json``, so that a sweep's missing and failed cells can be found later."""

from __future__ import annotations

import errno
import json
import os
import socket
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, get_args

from bench.errors import BenchError, first_line, require_choice
from bench.io.atomic import write_json
from bench.io.json_files import load_json

RunState = Literal["running", "done", "failed", "out_of_memory", "interrupted"]
STATES: tuple[str, ...] = get_args(RunState)
STATUS_FILE = "status.json"
SCORING = "scoring"
# What file systems give to the smallest file.
_BLOCK = 4096
# Frames, process ids and clock ticks are far below.
_MOST = 2**53


@dataclass(frozen=True)
class RunStatus:
    """What ``status.json`` holds. ``started`` and ``updated`` are UTC times in ISO 8601.

    ``process_started`` (clock ticks since boot, from ``/proc``) tells the process of this run from a later one that was
    given the same number. ``lost_stretches`` holds [first, last] frame number of every stretch without a pose.
    ``stage`` says what a running run is about: "mapping", "last optimisation", "rendering"; or, when only its scoring
    failed or was interrupted, "scoring". ``warnings`` say what makes the run's numbers doubtful, a sentence each.
    """

    state: str
    reason: str = ""
    frames_done: int = 0
    frames_total: int = 0
    lost_stretches: Sequence[Sequence[int]] = ()
    warnings: Sequence[str] = ()
    stage: str = ""
    pid: int = 0
    started: str = ""
    updated: str = ""
    host: str = ""
    process_started: int | None = None

    @property
    def is_complete(self) -> bool:
        """Whether the run got to its end and saved everything, scored or not."""
        return self.state == "done" or self.stage == SCORING

    def is_alive(self) -> bool:
        """Whether the process that wrote "running" still runs on this machine."""
        if self.state != "running" or self.host != socket.gethostname() or self.pid <= 0:
            return False
        try:
            os.kill(self.pid, 0)
        except ProcessLookupError:
            return False
        except PermissionError:
            pass  # it exists and belongs to someone else
        return self.process_started in (None, _process_started(self.pid))

    def describe(self) -> str:
        """The state in a few words; a "running" whose process is gone from this machine is called dead."""
        words = self.state.replace("_", " ")
        if self.state == "running" and self.host == socket.gethostname() and not self.is_alive():
            return "killed"
        return words


def current_status(
    state: str,
    reason: str,
    frames_done: int,
    frames_total: int,
    lost: Sequence[Sequence[int]],
    started: str,
    stage: str = "",
    warnings: Sequence[str] = (),
) -> RunStatus:
    """The status of this process now; ``started`` is "" on the first call. ``BenchError`` for an unknown state."""
    require_choice("state", state, STATES)
    now = datetime.now(UTC).isoformat(timespec="milliseconds")
    return RunStatus(
        state=state,
        reason=reason,
        frames_done=frames_done,
        frames_total=frames_total,
        lost_stretches=lost,
        warnings=warnings,
        stage=stage,
        pid=os.getpid(),
        started=started or now,
        updated=now,
        host=socket.gethostname(),
        process_started=_process_started(os.getpid()),
    )


def without_scores(status: RunStatus, state: str, reason: str) -> RunStatus:
    """Of a complete run whose scoring ended early, ``state`` and ``reason`` saying how."""
    reason = "scoring was interrupted" if state == "interrupted" else f"scoring: {reason}"
    return replace(status, state=state, reason=reason, stage=SCORING)


def write_status(folder: Path, status: RunStatus) -> None:
    """Write ``status.json`` of a run folder atomically; on a full disk over the old one, in the space that it has.

    Raises ``BenchError`` where neither can be done.
    """
    try:
        write_json(folder / STATUS_FILE, asdict(status))
    except BenchError as error:
        full = isinstance(error.__cause__, OSError) and error.__cause__.errno in (errno.ENOSPC, errno.EDQUOT)
        if not full or not (folder / STATUS_FILE).is_file():
            raise
        _overwrite(folder / STATUS_FILE, status)


def _overwrite(path: Path, status: RunStatus) -> None:
    """Write into the existing file, whose first block is there: not atomic, and short of words, but not lost."""
    room = max(path.stat().st_size, _BLOCK)
    content = json.dumps(asdict(status))
    if len(content) > room:
        content = json.dumps(asdict(replace(status, lost_stretches=(), warnings=(), reason=status.reason[:1000])))
    try:
        with open(path, "r+b") as file:
            file.write(content.encode())
            file.truncate()
    except OSError as error:
        raise BenchError(f"Can't write {path}: {error.strerror}. Free some space.") from error


def read_status(folder: Path) -> RunStatus | None:
    """Read ``status.json``, or None where there is none; raises ``BenchError`` for a damaged one."""
    path = folder / STATUS_FILE
    if not path.is_file():
        return None
    content = read_json(path)
    known = {name: content[name] for name in RunStatus.__dataclass_fields__ if content.get(name) is not None}
    for name, value in known.items():
        if not _fits(name, value):
            raise BenchError(f"{path}: {name} is {str(value)[:40]!r}, and no {name}; delete the file and run again.")
    if known.get("state") not in STATES:
        raise BenchError(f"{path} names no known state (one of {', '.join(STATES)}); delete the file and run again.")
    return RunStatus(**known)


def _fits(name: str, value: Any) -> bool:
    """Whether a value is of the kind that this field of ``status.json`` has, as its default says."""
    default = RunStatus.__dataclass_fields__[name].default
    if isinstance(default, tuple):
        fits = _is_stretch if name == "lost_stretches" else _is_text
        return isinstance(value, list) and all(map(fits, value))
    return _is_count(value) if default is None or isinstance(default, int) else _is_text(value)


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < _MOST


def _is_stretch(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(map(_is_count, value))


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object that the bench wrote; raises ``BenchError`` naming the file (and line) when it is missing,
    damaged, or holds what no run does. NaN and infinity become None, as in what ``write_json`` writes."""
    try:
        content = load_json(path, constant=lambda _: None)
    except json.JSONDecodeError as error:
        raise BenchError(f"{path} is damaged (line {error.lineno}: {error.msg}); delete it and run again.") from error
    except OSError as error:
        raise BenchError(f"Can't read {path}: {error}. Check the file and its permissions.") from error
    except (ValueError, RecursionError) as error:
        raise BenchError(f"{path} is damaged ({first_line(error)}); delete it and run again.") from error
    if not isinstance(content, dict):
        raise BenchError(
            f"{path} should hold a JSON object and holds a {type(content).__name__}; delete it and run again."
        )
    return content


def _process_started(pid: int) -> int | None:
    """Start time of a process in clock ticks since boot; None where the system doesn't tell."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return None
    # The command's name, in parentheses, may hold spaces; the 22nd field is the 20th after it.
    return int(stat.rpartition(")")[2].split()[19])
