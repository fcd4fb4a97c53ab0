"""``bgs-bench map``: what a saved map holds, and a frame of its run rendered from it again."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from bench import registry
from bench.contracts.mapper import Mapper
from bench.discovery import load_plugins
from bench.errors import BenchError
from bench.evaluation.saved_run import SavedRunFolder
from bench.gaussians.map import GaussianMap
from bench.gaussians.map_view import GaussianMapView
from bench.gaussians.parameters import NamedParameters
from bench.io.atomic import write_image
from bench.io.frame_range import describe
from bench.plugin_config import plugin_config_from
from bench.runs.folder import color_to_8bit
from bench.terminal import say
from bench.types import Image, PinholeView

_EXAMPLES = """examples:
  bgs-bench map results/runs/3f2a9c01d4e5
  bgs-bench map point_cloud.ply
  bgs-bench map results/runs/3f2a9c01d4e5 --view 5 --right --out view.png
"""
_QUANTILES = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0)


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser(
        "map",
        help="what a saved map of Gaussians holds; renders a frame of its run",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("source", type=Path, metavar="RUN_FOLDER|FILE.ply")
    parser.add_argument(
        "--view",
        type=int,
        metavar="FRAME",
        help="render this frame of the run, from its tracked pose, without its exposure",
    )
    parser.add_argument("--right", action="store_true", help="the right camera's view of it")
    parser.add_argument("--out", type=Path, metavar="FILE.png", help="where the rendered view goes")
    parser.add_argument(
        "--plugins",
        action="append",
        default=[],
        metavar="FOLDER",
        help="a folder of plugins that the run needs",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the map's numbers, or write a view; ``BenchError`` for what is no map, or no frame of the run."""
    if (args.view is None) != (args.out is None) or (args.right and args.view is None):
        raise BenchError("A view wants both --view FRAME and --out FILE.png (and --right for the right camera).")
    if args.view is not None and args.out.suffix.lower() != ".png":
        raise BenchError(f"--out {args.out} must end in .png.")
    if args.view is not None and not args.source.is_dir():
        raise BenchError(f"--view renders a frame of a run; give its run folder instead of {args.source}.")
    # Of the command line alone: code that the run folder names is a stranger's.
    load_plugins(args.plugins)
    if args.view is None:
        path = _map_file(SavedRunFolder(args.source)) if args.source.is_dir() else args.source
        _print(path, GaussianMap.load(path), Console())
    else:
        write_image(args.out, _rendered(SavedRunFolder(args.source), args.view, args.right))
        print(args.out)
    return 0


def _print(path: Path, gaussians: GaussianMap, console: Console) -> None:
    facts = f"{path}: {len(gaussians)} Gaussians, spherical harmonics of degree {gaussians.sh_degree}"
    say(f"{facts}, {path.stat().st_size / 1e6:.1f} MB", console)
    if not len(gaussians):
        return
    table = Table(box=None)
    table.add_column("quantile", no_wrap=True)
    for share in _QUANTILES:
        table.add_column(f"{100 * share:g} %", justify="right")
    named = NamedParameters(gaussians.planes)
    rows = {f"{axis}, m": named.means[:, k] for k, axis in enumerate("xyz")}
    rows |= {"opacity": named.opacities}
    rows |= {"longest axis, m": named.scales.amax(1), "shortest axis, m": named.scales.amin(1)}
    for name, values in rows.items():
        ordered = values.sort().values
        places = [round(share * (len(ordered) - 1)) for share in _QUANTILES]
        table.add_row(name, *(f"{float(ordered[place]):.4g}" for place in places))
    console.print(table)


def _map_file(saved: SavedRunFolder) -> Path:
    """The map that the run's mapper saved; ``BenchError`` for a mapper that saves none."""
    name = (saved.config.get("mapper") or {}).get("name")
    if name:
        saved.require("mapper", str(name))
    mapper = registry.lookup("mapper", str(name)).cls if name else Mapper
    assert issubclass(mapper, Mapper)
    if mapper.map_file is None:
        raise BenchError(f"The run {saved.path} has no map: its mapper ({name or 'unknown'}) saves none.")
    return saved.path / mapper.map_file


def _rendered(saved: SavedRunFolder, number: int, right: bool) -> Image:
    """A frame's view of the saved map, by the rasterizer, camera and trajectory of the run."""
    path = _map_file(saved)
    settings = saved.config["mapper"].get("rasterizer")
    if not isinstance(settings, dict):
        raise BenchError(f"The mapper of {saved.path} has no rasterizer to render its map with.")
    pose = saved.trajectory.pose_of(number)
    if pose is None:
        there = describe(saved.trajectory.numbers.tolist())
        raise BenchError(f"{saved.path} has no pose of frame {number}; it has those of {there}.")
    camera = saved.dataset.camera
    saved.require("rasterizer", str(settings.get("name", "")))
    rasterizer = registry.build(plugin_config_from("rasterizer", settings), "rasterizer")
    view = PinholeView.of(camera, pose @ camera.T_left_right if right else pose)
    gaussians = GaussianMap.load(path, rasterizer.device)
    return color_to_8bit(GaussianMapView(gaussians, rasterizer).render(view).color)
