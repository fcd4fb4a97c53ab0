"""Stands in for ``bgs-bench run`` in tests of sweeps: a run folder in milliseconds, or an end of the wanted kind.

Started as ``python fake_run.py JOB.json``; needs the standard library alone.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import sys
import time
from pathlib import Path


def main(job_file: Path) -> None:
    job = json.loads(job_file.read_text())
    control, folder, label = job_file.parent, Path(job["folder"]), job["label"]
    with open(control / "started.txt", "a") as started:
        started.write(f"{os.getpid()} {label}\n")
    behaviours = json.loads((control / "behaviour.json").read_text())
    behaviour = behaviours.get(label, behaviours.get("*", "ok"))
    if behaviour == "wrong":
        sys.exit("bgs-bench: the weights are missing")

    def status(state: str, reason: str = "") -> None:
        content = {"state": state, "reason": reason, "pid": os.getpid(), "host": socket.gethostname()}
        (folder / "status.json").write_text(json.dumps(content | {"frames_done": 2, "frames_total": 2}))

    folder.mkdir(parents=True, exist_ok=True)
    (folder / "config.yaml").write_text(job["config"])
    status("running")

    def note_gpu(what: str) -> None:
        with open(control / "gpus.txt", "a") as file:
            file.write(f"{what} {os.environ.get('CUDA_VISIBLE_DEVICES', 'none')}\n")

    def stop(signum: int, frame: object) -> None:
        status("interrupted", "stopped by the user")
        sys.exit(130)

    if behaviour == "polite":
        signal.signal(signal.SIGTERM, stop)
    if behaviour in ("hang", "polite"):
        (control / f"hangs-{job['seed']}").write_text(str(os.getpid()))
        time.sleep(60)
    if behaviour == "slow":
        note_gpu("begins")
        time.sleep(0.3)
        note_gpu("ends")
    if behaviour == "meet":
        note_gpu("begins")
        until = time.monotonic() + 30
        while (control / "gpus.txt").read_text().count("begins") < 2 and time.monotonic() < until:
            time.sleep(0.02)
        time.sleep(1.0)  # for the sweep to say that it has begun
        note_gpu("ends")
    if behaviour == "segv":
        os.kill(os.getpid(), signal.SIGSEGV)
    if behaviour == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    if behaviour == "oom-kill":
        # What the kernel does: it counts, then kills.
        (control / "vmstat").write_text("pgfault 12\noom_kill 8\n")
        os.kill(os.getpid(), signal.SIGKILL)
    if behaviour == "oom":
        status("out_of_memory", "40 GB wanted")
        sys.exit("bgs-bench: out of memory")
    views = {"left": {"n": 2, "psnr_db": 20.0 + job["seed"], "ssim": 0.5, "lpips": 0.25, "depth_l1_cm": 10.0}}
    metrics = {"protocol": {"name": "paper"}, "views": views, "frames": {"total": 2, "tracked": 2, "lost": 0}}
    (folder / "metrics.json").write_text(json.dumps(metrics))
    status("done")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
