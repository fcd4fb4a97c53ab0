"""How many processes the kernel has ended for want of memory: what tells such an end from a kill by hand."""

from __future__ import annotations

from pathlib import Path

_VMSTAT = Path("/proc/vmstat")
_OWN_CGROUP = Path("/proc/self/cgroup")
_CGROUPS = Path("/sys/fs/cgroup")


def oom_kills() -> int | None:
    """The kernel's count of this process's cgroup, else that of the whole machine; None where it keeps none.

    A run's own process is in the cgroup of the one that starts it, as is each of the others beside it.
    """
    for file in (_memory_events(), _VMSTAT):
        count = None if file is None else _count(file)
        if count is not None:
            return count
    return None


def _memory_events() -> Path | None:
    """The file of this process's cgroup (version 2; the root has none)."""
    try:
        lines = _OWN_CGROUP.read_text().splitlines()
    except OSError:
        return None
    path = next((line.removeprefix("0::") for line in lines if line.startswith("0::")), None)
    return None if path is None else _CGROUPS / path.lstrip("/") / "memory.events"


def _count(file: Path) -> int | None:
    try:
        pairs = dict(line.split() for line in file.read_text().splitlines())
    except OSError:
        return None
    return int(pairs["oom_kill"]) if "oom_kill" in pairs else None
