"""``make wheel-test``: a wheel, tried in an empty environment outside the checkout."""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import venv
from pathlib import Path
from zipfile import ZipFile

_TINY = ["dataset.frames=3", "dataset.width=160", "dataset.height=64", "mapper.iterations=2", "system=bgs_slam_fast"]
_COMMANDS = (
    ["--version"],
    ["--help"],
    ["list"],
    ["data", "list"],
    ["weights", "list"],
    ["run", *_TINY],
    ["table"],
    ["table", "main_kitti"],
    ["report", "results/runs", "--maps", "0", "--views", "1"],
    ["reproduce", "small_motion", "--dry-run"],
    ["new-plugin", "stereo", "my_net"],
    ["run", *_TINY, "stereo=my_net", "plugins=[my_plugins]"],
)
_FOREIGN = "raise RuntimeError('the package of another distribution was imported')\n"


def main() -> int:
    """Install and try; exit code 1, with what a command printed, where one fails."""
    parser = argparse.ArgumentParser(prog="python -m tools.wheel_check", description=__doc__)
    parser.add_argument("wheel", type=Path)
    parser.add_argument(
        "--whole",
        action="store_true",
        help="install the dependencies too (default: those of this environment are lent)",
    )
    given = parser.parse_args()
    wheel = given.wheel.resolve()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        top = {member.partition("/")[0] for member in ZipFile(wheel).namelist()}
        _require({part for part in top if not part.endswith(".dist-info")} == {"bench"}, f"{wheel.name} holds {top}")
        site = _environment(folder / "env", wheel, given.whole)
        # Anybody's `plugins` is left alone.
        (site / "plugins.py").write_text(_FOREIGN)
        program, work = folder / "env/bin/bgs-bench", folder / "work"
        work.mkdir()
        for command in _COMMANDS:
            code, printed = _run([str(program), *command], work)
            _require(code == 0, f"bgs-bench {' '.join(command)} ended with {code}:\n{printed}")
            print(f"ok  bgs-bench {' '.join(command)}", flush=True)
        (site / "bench/__init__.py").write_text("VERSION = '5'\n")
        code, printed = _run([str(program), "list"], work)
        _require(code == 2 and "another distribution's `bench`" in printed, f"with another `bench`: {code}\n{printed}")
        print("ok  another distribution's `bench` is told")
    return 0


def _environment(place: Path, wheel: Path, whole: bool) -> Path:
    """A new environment with the wheel; its folder of packages."""
    venv.create(place)
    install = [sys.executable, "-m", "pip", "--python", str(place / "bin/python"), "install", "--quiet"]
    subprocess.run(
        [*install, *(["--constraint", "constraints.txt"] if whole else ["--no-deps"]), str(wheel)], check=True
    )
    site = next(place.glob("lib/python*/site-packages"))
    if not whole:
        lent = [part for part in sys.path if part.endswith("-packages")]
        (site / "lent.pth").write_text("\n".join(lent) + "\n")
    return site


def _run(command: list[str], folder: Path) -> tuple[int, str]:
    done = subprocess.run(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    return done.returncode, done.stdout


def _require(holds: bool, otherwise: str) -> None:
    if not holds:
        sys.exit(f"wheel-test: {otherwise}")


if __name__ == "__main__":
    sys.exit(main())
