"""``bgs-bench vocabulary``: train a vocabulary of ORB descriptors, for loop closing or for ORB-SLAM3."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rich.console import Console

from bench import registry
from bench.config import compose_run
from bench.contracts.dataset import Dataset
from bench.errors import BenchError
from bench.io.atomic import atomic_path
from bench.tracking.loops.dbow2_text import write_dbow2
from bench.tracking.loops.training_images import DEFAULT_FEATURES, DEFAULT_FRAMES, descriptors_of
from bench.tracking.loops.vocabulary import train

_DEPTH = {"npz": 4, "dbow2": 6}
_SUFFIX = {"npz": ".npz", "dbow2": ".txt"}
_EXAMPLES = """examples:
  bgs-bench vocabulary --out street.npz
      from the built-in street, for tracker=stereo_orb tracker.vocabulary=street.npz
  bgs-bench vocabulary --format dbow2 --out kitti.txt dataset=kitti dataset.root=DIR dataset.sequence=06
      in DBoW2's text format, for tracker=orbslam3 tracker.vocabulary=kitti.txt, or ORB-SLAM2 and ORB-SLAM3 themselves
"""


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser(
        "vocabulary",
        help="train a vocabulary for loop closing, or for ORB-SLAM3",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="dataset=NAME and dataset.SETTING=VALUE")
    parser.add_argument("--out", type=Path, metavar="FILE", help="default: vocabulary.npz or vocabulary.txt")
    parser.add_argument("--format", choices=tuple(_DEPTH), help="default: by the ending of FILE (.npz, .txt), else npz")
    parser.add_argument("--branching", type=int, default=10, help="children of a node (default 10)")
    parser.add_argument("--depth", type=int, help="levels of the tree (default: 4 for npz, 6 for dbow2)")
    parser.add_argument("--frames", type=int, default=DEFAULT_FRAMES, help=f"frames used (default {DEFAULT_FRAMES})")
    parser.add_argument(
        "--features", type=int, default=DEFAULT_FEATURES, help=f"ORB features per frame (default {DEFAULT_FEATURES})"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the clustering (default 0)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Train and write the vocabulary and print what it is; ``BenchError`` for wrong input."""
    for override in args.overrides:
        if not override.lstrip("+").startswith(("dataset=", "dataset.", "plugins=")):
            raise BenchError(f"{override}: a vocabulary is trained from a data set only; give dataset=... settings.")
    if args.seed < 0:
        raise BenchError(f"--seed {args.seed} is negative; choose 0 or more.")
    form = args.format or ("dbow2" if args.out is not None and args.out.suffix == ".txt" else "npz")
    path: Path = args.out or Path(f"vocabulary{_SUFFIX[form]}")
    if not path.absolute().parent.is_dir():
        raise BenchError(f"--out {path}: the folder {path.absolute().parent} does not exist. Create it first.")
    dataset: Dataset = registry.build(compose_run(args.overrides).plugin("dataset"), "dataset")
    images = descriptors_of(dataset, args.frames, args.features)
    vocabulary = train(images, args.branching, _DEPTH[form] if args.depth is None else args.depth, args.seed)
    with atomic_path(path) as temporary:
        write_dbow2(temporary, vocabulary) if form == "dbow2" else vocabulary.save(temporary)
    Console().print(
        f"{path}: {len(vocabulary)} words from {sum(map(len, images))} descriptors of {len(images)} frames of "
        f"{dataset.label} ({form}, branching {vocabulary.branching}, depth {vocabulary.depth})",
        markup=False,
        highlight=False,
        soft_wrap=True,
    )
    return 0
