"""Data flows one way, and so do imports: read from the import statements themselves."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def imports_of(file: Path) -> set[str]:
    """Dotted names of the modules that a file imports, anywhere in it."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: relative imports hide the direction"
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def offences(folder: str, *forbidden: str, but: frozenset[str] = frozenset()) -> list[str]:
    """``file imports module`` for every import of a forbidden package, except from the files in ``but``."""
    path = ROOT / folder
    files = [path] if path.is_file() else sorted(path.rglob("*.py"))
    assert files, f"{folder} holds no Python"
    return [
        f"{name} imports {module}"
        for file in files
        if (name := str(file.relative_to(ROOT))) not in but
        for module in sorted(imports_of(file))
        if any(module == package or module.startswith(f"{package}.") for package in forbidden)
    ]


AFTER_MAPPING = ("bench.runs", "bench.evaluation", "bench.tables", "bench.system")
BEFORE_RUNS = ("bench.mapping", "bench.system", "bench.tracking", "bench.rendering")

RULES: list[tuple[str, tuple[str, ...], frozenset[str]]] = [
    # The framework knows kinds of plugins, never a plugin.
    ("bench", ("plugins",), frozenset({"bench/discovery.py"})),
    # Contracts know data and each other; only the evaluator's knows a saved run, since that is its input.
    (
        "bench/contracts",
        (*AFTER_MAPPING, "bench.commands", "bench.config"),
        frozenset({"bench/contracts/evaluator.py"}),
    ),
    # Evaluators and tables read what a run saved, never a live mapper.
    ("bench/evaluation", BEFORE_RUNS, frozenset()),
    ("plugins/evaluators", BEFORE_RUNS, frozenset()),
    ("bench/tables", BEFORE_RUNS, frozenset()),
    # Writing a run needs no mapper either.
    ("bench/runs", (*BEFORE_RUNS, "bench.tables", "bench.commands"), frozenset()),
    # Mapping and tracking know nothing of runs, scores or commands; nothing below knows the loop.
    ("bench/mapping", (*AFTER_MAPPING, "bench.tracking"), frozenset()),
    ("bench/tracking", (*AFTER_MAPPING, "bench.mapping"), frozenset()),
    ("bench/rendering", (*AFTER_MAPPING, "bench.tracking"), frozenset()),
    ("bench/geometry", (*AFTER_MAPPING, "bench.mapping"), frozenset()),
    ("bench/street", (*AFTER_MAPPING, "bench.mapping"), frozenset()),
    ("bench", ("bench.commands",), frozenset()),
    # A stage does not reach into the next one.
    ("plugins/datasets", ("plugins.stereo", "plugins.trackers", "plugins.mappers", *AFTER_MAPPING), frozenset()),
    ("plugins/stereo", ("plugins.trackers", "plugins.mappers", "bench.mapping", "bench.runs"), frozenset()),
    ("plugins/trackers", ("plugins.mappers", "bench.mapping", "bench.runs"), frozenset()),
    ("plugins/mappers", ("plugins.datasets", "plugins.trackers", *AFTER_MAPPING), frozenset()),
]


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: f"{rule[0]} without {rule[1][0]}")
def test_direction(rule: tuple[str, tuple[str, ...], frozenset[str]]) -> None:
    folder, forbidden, but = rule
    assert offences(folder, *forbidden, but=but) == []


def test_the_exceptions_are_needed() -> None:
    """An exception that nothing uses any more should go."""
    for _, forbidden, but in RULES:
        for file in but:
            assert offences(file, *forbidden), f"{file} needs no exception for {forbidden}"


def test_the_guard_sees_an_offence(tmp_path: Path) -> None:
    file = tmp_path / "bad.py"
    file.write_text("def f():\n    from plugins.stereo import sgbm\n    import bench.system\n")
    assert imports_of(file) == {"plugins.stereo.sgbm", "bench.system"}


def test_evaluator_contract_knows_the_saved_run_alone() -> None:
    of_runs = {
        module for module in imports_of(ROOT / "bench/contracts/evaluator.py") if module.startswith("bench.runs")
    }
    assert of_runs == {"bench.runs.saved.SavedRun"}


def test_nothing_imports_what_the_licence_forbids() -> None:
    """evo is GPL and serves tests only; scipy is not one of the project's dependencies."""
    assert offences("bench", "evo", "scipy") + offences("plugins", "evo", "scipy") == []
