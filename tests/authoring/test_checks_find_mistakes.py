"""Each check finds the mistake that it is for: a working plugin is spoilt in one place, and the verdict says what is
wrong, how to mend it, and on which line.

The mistakes are in ``mistakes/<kind>.txt``: the check that must find it, what is replaced (-) by what (+) in the file
that ``new-plugin`` writes, patterns of what the finding says and of how to mend it, and text on the line that it
points to.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from bench.authoring.verdict import Finding


@dataclass(frozen=True)
class Mistake:
    """One block of a file of mistakes."""

    kind: str
    name: str
    check: str
    old: str
    new: str
    says: str
    line: str
    mend: str


def read_mistakes(file: Path) -> list[Mistake]:
    mistakes = []
    for block in f"\n{file.read_text()}".split("\n== ")[1:]:
        name, *rows = block.rstrip("\n").split("\n")
        old, new = ("\n".join(row[2:] for row in rows if row.startswith(sign)) for sign in ("- ", "+ "))
        check, says, line, mend = (
            next((row.removeprefix(key) for row in rows if row.startswith(key)), "")
            for key in ("check: ", "says: ", "line: ", "mend: ")
        )
        assert check, f"{file}, {name}: no check"
        assert says, f"{file}, {name}: says nothing"
        mistakes.append(Mistake(file.stem, name, check, old, new, says, line, mend))
    return mistakes


MISTAKES = [mistake for file in sorted(Path(__file__).parent.glob("mistakes/*.txt")) for mistake in read_mistakes(file)]


@pytest.mark.slow
@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda mistake: f"{mistake.kind}: {mistake.name}")
def test_a_mistake_is_found_and_placed(mistake: Mistake, finding_about: Callable[..., Finding], tmp_path: Path) -> None:
    finding = finding_about(mistake.kind, mistake.check, (mistake.old, mistake.new))
    assert finding.state == "FAILED", finding
    assert re.search(mistake.says, finding.seen), finding.seen
    assert re.search(mistake.mend, finding.mend), finding.mend
    assert finding.expected
    file, _, line = finding.place.rpartition(":")
    assert Path(file) == tmp_path / "probed.py"
    pointed_at = Path(file).read_text().splitlines()[int(line) - 1]
    assert mistake.line in pointed_at


@pytest.mark.slow
def test_an_evaluator_that_counts_on_the_order_of_views_is_found(finding_about: Callable[..., Finding]) -> None:
    """It takes the view that came last for the last one of the run."""
    methods = """def start(self, run):
        pass

    def view(self, view):
        self.last = view.number

    def finish(self, scores):
        return {"probed": {"path_m": float(self.last)}}

    def unused(self, run):"""
    found = finding_about(
        "evaluator",
        "determinism",
        ("import Evaluator\n", "import ViewEvaluator\n"),
        ("Probed(Evaluator)", "Probed(ViewEvaluator)"),
        ("def evaluate(self, run: SavedRun) -> dict[str, Any]:", methods),
    )
    assert "views in another order" in found.seen
    assert "keep nothing in view()" in found.mend
