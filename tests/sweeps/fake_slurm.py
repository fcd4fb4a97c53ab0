"""Stands in for Slurm's commands: ``fake_slurm.py sbatch|srun|sacct|sinfo ARGUMENTS``; jobs run on this machine.

Slurm's real scheduler is not tested by this, but that what we submit is what Slurm's commands are given, and that what
they start finds its run.
"""

from __future__ import annotations

import os
import re
import stat
import subprocess
import sys
from pathlib import Path

JOB = 700


def install(folder: Path, gpus: str) -> None:
    """Put the commands into ``folder``, for a PATH; ``gpus`` is what sinfo says of the partition's."""
    folder.mkdir()
    (folder / "gpus").write_text(gpus)
    for name in ("sbatch", "srun", "sacct", "sinfo"):
        command = folder / name
        command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -S "{__file__}" {name} "$@"\n')
        command.chmod(command.stat().st_mode | stat.S_IXUSR)


def sbatch(folder: Path, arguments: list[str]) -> None:
    script = Path(arguments[-1]).read_text()
    (folder / "submitted").write_text(script)
    found = re.search(r"--array=0-(\d+)", script)
    assert found is not None
    for task in range(int(found[1]) + 1):
        variables = {
            **{"SLURM_JOB_ID": str(JOB + task), "SLURM_ARRAY_JOB_ID": str(JOB), "SLURM_ARRAY_TASK_ID": str(task)},
            **{"SLURM_NTASKS": "1", "SLURM_JOB_NUM_NODES": "1", "SLURM_JOB_NODELIST": "node1"},
            **{"SLURM_PROCID": "0", "SLURM_LOCALID": "0", "SLURM_NODEID": "0"},
        }
        silent = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        subprocess.Popen(["bash", arguments[-1]], env=os.environ | variables, **silent)
    print(f"Submitted batch job {JOB}")


def srun(folder: Path, arguments: list[str]) -> None:
    start = next(i for i, argument in enumerate(arguments) if Path(argument).name.startswith("python"))
    os.execv(arguments[start], arguments[start:])


def sacct(folder: Path, arguments: list[str]) -> None:
    print("JobID|State|NodeList")


def sinfo(folder: Path, arguments: list[str]) -> None:
    (folder / "asked").write_text(" ".join(arguments))
    print((folder / "gpus").read_text())


if __name__ == "__main__":
    place = Path(next(path for path in os.environ["PATH"].split(":") if (Path(path) / "gpus").exists()))
    {"sbatch": sbatch, "srun": srun, "sacct": sacct, "sinfo": sinfo}[sys.argv[1]](place, sys.argv[2:])
