"""Data flows one way, and so do imports: the graph of folders is computed from the import statements themselves."""

from __future__ import annotations

import ast
import itertools
from collections.abc import Iterable, Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def imports_of(file: Path) -> set[str]:
    """Dotted names that a file imports, anywhere in it: of ``from a import b`` the name ``a.b``."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            beside = node.level == 1 and "plugins" in file.parts  # `plugins` has another name where it is installed
            assert node.level == 0 or beside, f"{file}: relative imports hide the direction"
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def modules_of(root: Path, package: str) -> dict[str, Path]:
    """Every module of a package by its dotted name."""
    files = sorted((root / package).rglob("*.py"))
    return {".".join(file.relative_to(root).with_suffix("").parts).removesuffix(".__init__"): file for file in files}


def room_of(module: str, files: Mapping[str, Path]) -> str:
    """The folder that a module lies in; a module right in the package is a room of its own."""
    if files[module].name == "__init__.py":
        return module
    folder = module.rpartition(".")[0]
    return folder if "." in folder else module


def graph_of(root: Path, package: str) -> dict[str, dict[str, str]]:
    """For each room, the rooms that it imports from, each with one import as evidence."""
    files = modules_of(root, package)
    graph: dict[str, dict[str, str]] = {}
    for module, file in files.items():
        here = graph.setdefault(room_of(module, files), {})
        for name in imports_of(file):
            while name and name not in files:
                name = name.rpartition(".")[0]
            if name and name != package and room_of(name, files) != room_of(module, files):
                here[room_of(name, files)] = f"{module} imports {name}"
    return graph


def cycle_of(graph: Mapping[str, Mapping[str, str]]) -> list[str]:
    """The imports that close a circle of rooms, one after the other; empty without a circle."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        circle = error.args[1][::-1]
        return [graph[here][there] for here, there in itertools.pairwise(circle)]
    return []


def offences(folder: str, forbidden: Iterable[str]) -> list[str]:
    """``file imports module`` for every import of a forbidden package in a folder."""
    files = sorted((ROOT / folder).rglob("*.py"))
    assert files, f"{folder} holds no Python"
    return [
        f"{file.relative_to(ROOT)} imports {module}"
        for file in files
        for module in sorted(imports_of(file))
        if any(module == package or module.startswith(f"{package}.") for package in forbidden)
    ]


def test_no_folder_of_bench_is_in_a_circle_of_imports() -> None:
    assert cycle_of(graph_of(ROOT, "bench")) == []


def test_the_guard_sees_a_circle(tmp_path: Path) -> None:
    for file, text in {
        "__init__.py": "",
        "low/a.py": "def f():\n    from pack.high import b\n",
        "high/b.py": "import pack.middle.c\n",
        "middle/c.py": "from pack.low.a import f\n",
    }.items():
        (tmp_path / "pack" / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "pack" / file).write_text(text)
    assert sorted(cycle_of(graph_of(tmp_path, "pack"))) == [
        "pack.high.b imports pack.middle.c",
        "pack.low.a imports pack.high.b",
        "pack.middle.c imports pack.low.a",
    ]


LIVE = ("bench.gaussians", "bench.slam", "bench.tracking")
AFTER_MAPPING = ("bench.runs", "bench.evaluation", "bench.tables", "bench.slam")

# What no circle would show: stages that must not know of one another though nothing in the other direction does.
RULES = {
    # Evaluators and tables read what a run saved, never a live mapper, so any system's output is scored alike.
    "bench/evaluation": LIVE,
    "plugins/evaluators": LIVE,
    "bench/tables": LIVE,
    "bench/external": LIVE,
    # What is to be run is known from a table's rows and columns, not from how tables are written.
    "bench/sweeps": (
        "bench.tables.document",
        "bench.tables.render",
        "bench.tables.collect",
        "bench.tables.named.table",
    ),
    # A stage does not reach into the next one.
    "plugins/datasets": ("plugins.stereo", "plugins.trackers", "plugins.mappers", "bench.gaussians", *AFTER_MAPPING),
    "plugins/stereo": ("plugins.trackers", "plugins.mappers", "bench.gaussians", *AFTER_MAPPING),
    "plugins/trackers": ("plugins.mappers", "bench.gaussians", *AFTER_MAPPING),
    "plugins/mappers": ("plugins.datasets", "plugins.trackers", *AFTER_MAPPING),
    # evo is GPL and serves tests only.
    "bench": ("evo", "tools"),
    # Where they are installed they are bench.builtin.plugins, so that `plugins` stays free.
    "plugins": ("evo", "tools", "plugins"),
}


@pytest.mark.parametrize("folder", RULES)
def test_what_a_folder_must_not_know(folder: str) -> None:
    assert offences(folder, RULES[folder]) == []


def test_the_framework_knows_no_plugin() -> None:
    assert offences("bench", ["plugins"]) == []
