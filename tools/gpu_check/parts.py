"""The parts of the check: each in a process of its own, which can be ended, within what is left of the time."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.runs.status import read_json

Outcome = dict[str, Any]
"""``status``: done, failed, out of time or left out; ``seconds``; ``reason`` of all but done; what was measured as
``result``, also by a part that ended early."""


@dataclass(frozen=True)
class Part:
    """A part may take ``longest_s``, and does not begin where less than ``least_s`` are left."""

    name: str
    longest_s: float
    least_s: float
    needed: bool = False
    """The parts after it can do nothing without it."""


PARTS = (
    Part("kernels", 300, 20, needed=True),
    Part("conformance", 90, 25),
    Part("mapping_step", 90, 25),
    Part("whole_system", 150, 40),
    Part("marked_tests", 100, 20),
)


def run_parts(
    parts: Sequence[Part],
    run: Callable[[str, float], Outcome],
    limit_s: float,
    tell: Callable[[str, Outcome], None],
    clock: Callable[[], float] = time.monotonic,
) -> dict[str, Outcome]:
    """The outcome of each part by its name; ``run`` is given the name and the seconds that it has."""
    begin, lacking, outcomes = clock(), "", {}
    for part in parts:
        left = limit_s - (clock() - begin)
        if lacking or left < part.least_s:
            reason = lacking or f"{max(left, 0):.0f} s were left, and it wants {part.least_s:g}"
            outcome: Outcome = {"status": "left out", "seconds": 0.0, "reason": reason}
        else:
            outcome = run(part.name, min(part.longest_s, left))
        if part.needed and outcome["status"] != "done":
            lacking = f"{part.name} was not done"
        outcomes[part.name] = outcome
        tell(part.name, outcome)
    return outcomes


def run_in_process(
    name: str, seconds: float, folder: Path, command: Sequence[str] = (), environment: Mapping[str, str] | None = None
) -> Outcome:
    """Run a part; its output goes to ``folder/NAME.log`` and what it measures to ``folder/NAME.json``.

    ``command`` is what is started in place of this package. A part that takes longer is killed with its children.
    """
    folder.mkdir(parents=True, exist_ok=True)
    log, result = folder / f"{name}.log", folder / f"{name}.json"
    result.unlink(missing_ok=True)
    given = [*(command or (sys.executable, "-m", "tools.gpu_check", "--part", name, "--to", str(result)))]
    begin, reason = time.monotonic(), None
    with log.open("wb") as output:
        process = subprocess.Popen(
            given, stdout=output, stderr=subprocess.STDOUT, start_new_session=True, env=environment
        )
        try:
            status = "failed" if process.wait(seconds) else "done"
        except subprocess.TimeoutExpired:
            status, reason = "out of time", f"ended after {seconds:.0f} s"
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
    outcome: Outcome = {"status": status, "seconds": round(time.monotonic() - begin, 1)}
    if status == "failed":
        reason = _last_line(log)
    if reason is not None:
        outcome["reason"] = reason
    if result.is_file():
        outcome["result"] = read_json(result)
    return outcome


def _last_line(log: Path) -> str:
    lines = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
    return f"{lines[-1] if lines else 'it ended without a word'} ({log})"
