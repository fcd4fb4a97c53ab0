"""A run's map in 3D: a page of its own, which splat-transform (an npm package) writes from the PLY file."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from bench.errors import BenchError, first_line
from bench.evaluation.saved_run import SavedRunFolder
from bench.io.atomic import atomic_path
from bench.saved_map import map_file
from bench.types import Trajectory

VERSION = "2.7.1"
"""Of @playcanvas/splat-transform; the Makefile names it too."""
_FOLDER = Path(__file__).parents[3] / "build" / "map_viewer"
_PROGRAM = Path("node_modules", "@playcanvas", "splat-transform", "bin", "cli.mjs")
_HOW = (
    f"In a checkout `make map-viewer` installs it (node 18 or newer is needed); elsewhere `npm install --prefix FOLDER "
    f"@playcanvas/splat-transform@{VERSION}` and BGS_MAP_VIEWER=FOLDER."
)
_LONGEST_S = 900
_AHEAD_M = 10.0
# In degrees; a car's camera has about this from side to side.
_FIELD_OF_VIEW = 75


def viewer() -> list[str]:
    """The command that writes the page; ``BenchError`` with what to install where node or the package is missing."""
    node = shutil.which("node")
    if node is None:
        raise BenchError(f"The map in 3D needs node, which is not there, and the package splat-transform. {_HOW}")
    program = Path(os.environ.get("BGS_MAP_VIEWER") or _FOLDER) / _PROGRAM
    if not program.is_file():
        raise BenchError(f"The map in 3D needs the npm package splat-transform, which is not there. {_HOW}")
    return [node, str(program)]


def shown_map(saved: SavedRunFolder) -> Path:
    """The PLY file with the run's map; ``BenchError`` where the mapper saves none, or none is there."""
    path = map_file(saved)
    if path.suffix != ".ply":
        raise BenchError(f"{path} is no map of Gaussians as PLY, so there is no map in 3D.")
    if not path.is_file() or path.is_symlink():
        raise BenchError(f"{path} is not there, so there is no map in 3D: the run saves it at its end.")
    return path


def write_map_page(command: list[str], ply: Path, trajectory: Trajectory | None, page: Path) -> None:
    """Write ``page``, which shows the map from the first pose of ``trajectory``; ``BenchError`` where that fails."""
    with tempfile.TemporaryDirectory() as folder, atomic_path(page) as temporary:
        settings = Path(folder) / "settings.json"
        settings.write_text(json.dumps(_settings(trajectory)))
        options = ["--quiet", "--overwrite", "--gpu", "cpu", "--filter-nan", "--viewer-settings", str(settings)]
        arguments = [*command, *options[:4], str(ply.resolve()), options[4], *options[5:], str(temporary.resolve())]
        try:
            ended = subprocess.run(arguments, capture_output=True, text=True, errors="replace", timeout=_LONGEST_S)
        except subprocess.TimeoutExpired:
            raise BenchError(f"splat-transform took more than {_LONGEST_S} s for {ply}, and was ended.") from None
        if ended.returncode != 0 or not temporary.is_file():
            said = first_line(RuntimeError(ended.stderr or ended.stdout or "it said nothing"))
            raise BenchError(f"splat-transform can't write the map in 3D of {ply}: {said}.")


def _settings(trajectory: Trajectory | None) -> dict[str, object]:
    """The viewer's settings (version 2 of its schema): where its camera stands first, and no effects."""
    position, target = [0.0, 0.0, 0.0], [0.0, 0.0, _AHEAD_M]
    if trajectory is not None and len(trajectory):
        T = trajectory.T_world_cam[0]
        ahead = T[:3, 3] + _AHEAD_M * T[:3, 2]
        # The viewer turns maps, in which y points down, upside down about z.
        position, target = ([-float(p[0]), -float(p[1]), float(p[2])] for p in (T[:3, 3], ahead))
    off = {"enabled": False}
    effects = {
        "sharpness": off | {"amount": 0},
        "bloom": off | {"intensity": 1, "blurLevel": 2},
        "grading": off | {"brightness": 0, "contrast": 1, "saturation": 1, "tint": [1, 1, 1]},
        "vignette": off | {"intensity": 0.5, "inner": 0.3, "outer": 0.75, "curvature": 1},
        "fringing": off | {"intensity": 0.5},
    }
    return {
        "version": 2,
        "tonemapping": "none",
        "highPrecisionRendering": False,
        "background": {"color": [0.4, 0.4, 0.4]},
        "postEffectSettings": effects,
        "animTracks": [],
        "cameras": [{"initial": {"position": position, "target": target, "fov": _FIELD_OF_VIEW}}],
        "annotations": [],
        "startMode": "default",
    }
