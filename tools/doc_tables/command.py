"""The maintainer's command: the tables in README.md and docs/, from what is kept in ``results/tables``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from bench.errors import BenchError
from bench.io.atomic import write_text
from tools.doc_tables.blocks import MARKER, update
from tools.doc_tables.definitions import BLOCKS
from tools.doc_tables.performance import FILE, performance_text

_ABOUT = f"""Rewrites the tables of Markdown files, each between <!-- table: NAME --> and <!-- end -->, from the files
kept in results/tables (gpu: in results/gpu). NAME is one of {", ".join(BLOCKS)}.
A table whose files are not kept yet stays as it is and is named."""

_KEPT = Path("results/tables")

_EXAMPLES = """examples:
  bgs-bench table RUN_FOLDER ... --out results/tables/kitti06.runs.json     # keep runs
  make bench && python -m tools.doc_tables --performance results/performance  # keep the benchmarks
  python -m tools.doc_tables                 # then the tables
  python -m tools.doc_tables --check          # exit code 1 where a table is stale"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Rewrite the files. Exit code 0; 1 where ``--check`` finds a stale table; 2 for wrong input."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.doc_tables",
        description=_ABOUT,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "files", nargs="*", type=Path, metavar="FILE", help="default: README.md and all pages in docs/ with such tables"
    )
    parser.add_argument("--check", action="store_true", help="only say which tables are stale")
    parser.add_argument(
        "--kept", type=Path, metavar="FOLDER", default=_KEPT, help=f"where the records are (default: {_KEPT})"
    )
    parser.add_argument(
        "--performance", type=Path, metavar="FOLDER", help=f"first keep the benchmarks in this folder as {FILE}"
    )
    try:
        return run(parser.parse_args(arguments))
    except BenchError as error:
        print(f"tools.doc_tables: {error}", file=sys.stderr)
        return error.exit_code


def run(args: argparse.Namespace) -> int:
    """As ``main``; raises ``BenchError`` for wrong input."""
    if args.performance is not None:
        _keep_performance(args.performance, args.kept / FILE)
    stale = False
    for file in args.files or pages_with_tables(Path()):
        updated = update(file, args.kept, BLOCKS)
        stale |= bool(updated.stale)
        for reason in updated.lacking:
            print(f"left as it is: {reason}")
        if args.check:
            for name in updated.stale:
                print(f"{file}, stale: {name}; run `python -m tools.doc_tables`")
            continue
        if updated.stale:
            write_text(file, updated.text)
        print(f"{file}: {', '.join(updated.stale) or 'nothing'} made again")
    return 1 if args.check and stale else 0


def pages_with_tables(root: Path) -> list[Path]:
    """The Markdown files of a checkout that have such tables."""
    pages = [root / "README.md", *sorted((root / "docs").rglob("*.md"))]
    return [page for page in pages if MARKER.search(page.read_text(encoding="utf-8"))]


def _keep_performance(folder: Path, file: Path) -> None:
    # Provenance imports torch, which the rest of this command does without.
    from bench.runs.provenance import collect_provenance

    found = collect_provenance({}, 0)
    commit = (found["git"] or {}).get("commit") or "unknown"
    machine = {key: found["machine"][key] for key in ("cpu", "usable_cores", "gpu")}
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BenchError(f"Can't make the folder {file.parent}: {error.strerror}. Give another --kept.") from error
    write_text(file, performance_text(folder, machine, commit))
    print(f"wrote {file}")
