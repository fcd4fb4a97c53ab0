"""A named table as lines of cells with their marks, the same for every format."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from bench.contracts.metric import Metric
from bench.errors import require_choice
from bench.tables.document.model import UNKNOWN, Cell, Column
from bench.tables.named.definitions import MethodRow, NamedTable
from bench.tables.named.fill import FilledTable, Statistic
from bench.tables.named.published import AVERAGE, PublishedValue, read_published
from bench.tables.static_camera import NAME as STATIC_CAMERA

DAGGER, CROSS, MINUS = "\u2020", "\u00d7", "\u2212"
OURS, PAPER, ELSEWHERE, COMPUTED = "ours", "paper", "elsewhere", "computed"
COLUMNS = ("both", "ours", "paper")
"""Whose numbers a table may show: those of our runs, of the paper (and what it has from elsewhere), or both."""
COMPARED = "vs. paper"
"""The paper's number of another method, with ours of a method that the paper does not have."""
WITHHELD = "withheld"


@dataclass(frozen=True)
class Line:
    """One line: whose numbers (``by``), of which method, which metric (None: the columns are metrics), its cells."""

    by: str
    method: str
    metric: Metric | None
    cells: tuple[Cell, ...]


@dataclass(frozen=True)
class Grid:
    """``columns`` head the cells; ``blocks`` are the methods, each with its lines.

    ``beside``: a method is shown as one line, with the paper's numbers beside ours.
    """

    name: str
    title: str
    columns: tuple[Column, ...]
    blocks: tuple[tuple[Line, ...], ...]
    has_metric_column: bool
    beside: bool = False


@dataclass(frozen=True)
class _Slot:
    """Where a number belongs: the column's sequence (or "average") and its metric."""

    sequence: str
    metric: Metric


def heading(metric: Metric) -> str:
    """Title, unit and, where it is known, which way is better: ``ATE [m] ↓``."""
    unit = f" [{metric.unit}]" if metric.unit else ""
    return metric.title + unit + {"lower": " ↓", "higher": " ↑", None: ""}[metric.better]


def in_digits(value: float, metric: Metric) -> str:
    """A value, or a spread, with as many decimals as the metric is shown with."""
    return f"{value:,.0f}" if metric.decimals is None else f"{value:.{metric.decimals}f}"


class PublishedNumbers:
    """The published numbers of a table by method, metric and sequence."""

    def __init__(self, table: NamedTable) -> None:
        self.paper = [value for file in table.published for value in read_published(file, table.name)]
        self.references = [value for file in table.references for value in read_published(file, table.name)]
        for value in self.paper:
            _require_place(table, value)
        self._by_key = {(v.method, v.metric, v.sequence): v for v in [*self.paper, *self.references]}

    def get(self, method: str, metric: str, sequence: str) -> PublishedValue | None:
        """The number, or None; ``BenchError`` was raised before for a damaged file."""
        return self._by_key.get((method, metric, sequence))

    def reference_methods(self) -> list[str]:
        """Methods that come from elsewhere, in the file's order."""
        return list(dict.fromkeys(value.method for value in self.references))


def _require_place(table: NamedTable, value: PublishedValue) -> None:
    """Raise ``BenchError`` for a number of the paper's that the table would not show."""
    metric = next((metric for metric in table.metrics if metric.key == value.metric), None)
    for what, has, accepted in (
        ("method", value.method, [row.published for row in table.rows if row.published]),
        ("metric", value.metric, [metric.key for metric in table.metrics]),
        ("sequence", value.sequence, [*table.sequences, AVERAGE]),
        ("dataset", value.dataset, [table.dataset]),
        ("unit", value.unit, [metric.unit if metric else value.unit]),
    ):
        require_choice(f"{table.file}: a published number has no place in the table: {what}", has, accepted)


def build_grid(filled: FilledTable, published: PublishedNumbers, columns_of: str = "both") -> Grid:
    """Blocks in the paper's order, then the static camera and other references; the best of each column marked.

    ``columns_of``: whose numbers, one of ``COLUMNS``.
    """
    table = filled.table
    builder = _Builder(filled, published, columns_of)
    blocks = [builder.block(row) for row in table.rows]
    has_ate = any(metric.key == "ate_rmse_m" for metric in table.metrics)
    static = [_static_camera(filled)] if has_ate and columns_of != "paper" else []
    references = published.reference_methods() if columns_of != "ours" else []
    from_elsewhere = [builder.reference(method) for method in references]
    marked = _mark_best(blocks, PAPER, table.metrics)
    marked = _mark_best(marked, OURS, table.metrics)
    across_sequences = table.across == "sequences"
    columns = [_sequence_column(filled, sequence) for sequence in table.sequences] + [Column("Average", align="right")]
    columns = columns if across_sequences else [Column(heading(metric), align="right") for metric in table.metrics]
    shown = [tuple(block) for block in [*marked, *static, *from_elsewhere] if block]
    shown = [_dagger_at_name(block) for block in shown] if across_sequences else shown
    return Grid(table.name, table.title, tuple(columns), tuple(shown), across_sequences, not across_sequences)


class _Builder:
    def __init__(self, filled: FilledTable, published: PublishedNumbers, columns_of: str) -> None:
        self._filled = filled
        self._published = published
        self._columns_of = columns_of

    def block(self, row: MethodRow) -> list[Line]:
        """Lines of a method: ours above the paper's, metric by metric."""
        can_have_ours = (row.overrides or self._filled.has_runs(row.label)) and self._columns_of != "paper"
        ours = self._lines(OURS, row.label, lambda slot: self._our_cell(row, slot)) if can_have_ours else []
        compared = row.published or row.compared_with
        by = PAPER if row.published else COMPARED
        paper = self._lines(by, row.label, lambda slot: self._paper_cell(row, compared, slot))
        has_nothing_beside = not any(cell.value is not None for line in ours for cell in line.cells)
        if self._columns_of == "ours" or (not row.published and has_nothing_beside):
            paper = []
        pairs = zip(ours, paper, strict=True) if ours and paper else ((line,) for line in ours or paper)
        return [line for pair in pairs for line in pair if line.by == OURS or any(cell.text for cell in line.cells)]

    def reference(self, method: str) -> list[Line]:
        """Lines of a method whose numbers come from elsewhere; only metrics that have a place in the table."""
        by = COMPUTED if method.startswith(STATIC_CAMERA) else ELSEWHERE
        lines = self._lines(by, method, lambda slot: _published_cell(self._published_at(method, slot)))
        return [line for line in lines if any(cell.text for cell in line.cells)]

    def _lines(self, by: str, method: str, cell: Callable[[_Slot], Cell]) -> list[Line]:
        table = self._filled.table
        if table.across == "metrics":
            cells = tuple(cell(_Slot(next(iter(table.sequences)), metric)) for metric in table.metrics)
            return [Line(by, method, None, cells)]
        columns = (*table.sequences, AVERAGE)
        return [
            Line(by, method, metric, tuple(cell(_Slot(sequence, metric)) for sequence in columns))
            for metric in table.metrics
        ]

    def _published_at(self, method: str, slot: _Slot) -> PublishedValue | None:
        return self._published.get(method, slot.metric.key, slot.sequence)

    def _our_cell(self, row: MethodRow, slot: _Slot) -> Cell:
        table = self._filled.table
        if slot.sequence == AVERAGE:
            parts = [self._filled.cells.get((row.label, sequence)) for sequence in table.sequences]
            mark = DAGGER if any(cell is not None and cell.is_part for cell in parts) else ""
            average = self._filled.average(row.label, slot.metric)
            return Cell() if average is None else statistic_cell(average, slot.metric, mark)
        cell = self._filled.cells.get((row.label, slot.sequence))
        if cell is None:
            return Cell(WITHHELD if self._filled.facts[slot.sequence].withheld else "")
        links = tuple((str(run.seed), run.source) for run in cell.shown or cell.without_numbers)
        if not cell.shown:
            return Cell(CROSS if cell.state == "out of memory" else cell.state, links=links)
        if not slot.metric.of_part and any(run.state == "out of memory" for run in cell.shown):
            return Cell(CROSS, links=links)
        found = statistic_cell(cell.statistic(slot.metric), slot.metric, DAGGER if cell.is_part else "")
        return replace(found, links=links)

    def _paper_cell(self, row: MethodRow, method: str, slot: _Slot) -> Cell:
        """The paper's number, and in brackets how far ours is from it; a dagger is on the method's name.

        Beside ours of a method that the paper does not have, the difference alone.
        """
        published = self._published_at(method, slot)
        shown = _published_cell(published)
        ours = self._our_cell(row, slot).value if self._columns_of == "both" else None
        is_anothers = not row.published and self._filled.table.across == "metrics"
        if published is None or shown.value is None or ours is None:
            return Cell() if is_anothers else shown
        difference = f"({signed(ours - shown.value, len(published.value.partition('.')[2]))})"
        return replace(shown, text=difference if is_anothers else f"{shown.text} {difference}")


def _published_cell(published: PublishedValue | None) -> Cell:
    if published is None:
        return Cell()
    if published.status == "cross":
        return Cell(CROSS)
    mark = DAGGER if published.status == "dagger" else ""
    return Cell(published.value or "n/r", mark=mark, value=published.number)


def statistic_cell(found: Statistic | None, metric: Metric, mark: str = "") -> Cell:
    """A mean over runs and its spread, or that it is not known."""
    if found is None:
        return Cell(UNKNOWN)
    spread = "" if found.std is None else f" ± {in_digits(found.std, metric)}"
    return Cell(f"{in_digits(found.mean, metric)}{spread}", found.n, mark, value=found.mean)


def signed(difference: float, decimals: int) -> str:
    """A difference with its sign."""
    text = f"{difference:+.{decimals}f}".replace("-", MINUS)
    # A difference that rounds to nothing has no sign.
    return text if text.strip(f"+{MINUS}0.") else text[1:]


def _sequence_column(filled: FilledTable, sequence: str) -> Column:
    """As in the paper, with km and frames where they are known: ``(0.56/801)``."""
    facts = filled.facts[sequence]
    frames = f"{facts.frames / 1000:g}k" if facts.frames_rounded_to > 1 else str(facts.frames)
    return Column(sequence, f"({facts.length_km:g}/{frames})" if facts.frames else "", "right")


def _static_camera(filled: FilledTable) -> list[Line]:
    """What a camera that never moves gets on the frames of our runs; empty without runs."""
    table = filled.table
    metric = next(metric for metric in table.metrics if metric.key == "ate_rmse_m")
    cells = []
    for sequence in table.sequences:
        known = [
            (cell.frames, run.static_camera_m, cell.is_part)
            for (_, column), cell in filled.cells.items()
            if column == sequence
            for run in cell.shown
            if run.static_camera_m is not None
        ]
        if not known:
            cells.append(Cell(WITHHELD if filled.facts[sequence].withheld else ""))
            continue
        _, error, is_part = max(known, key=lambda item: item[0])
        cells.append(Cell(in_digits(error, metric), mark=DAGGER if is_part else "", value=error))
    name = f"{STATIC_CAMERA}, frames of our runs"
    if table.across == "metrics":
        return [Line(COMPUTED, name, None, tuple(cells[0] if each is metric else Cell() for each in table.metrics))]
    values = [cell.value for cell in cells if cell.value is not None]
    average = Cell()
    if len(values) == len(cells):
        mean = sum(values) / len(values)
        mark = DAGGER if any(cell.mark for cell in cells) else ""
        average = Cell(in_digits(mean, metric), mark=mark, value=mean)
    return [Line(COMPUTED, name, metric, (*cells, average))]


def _mark_best(blocks: Sequence[list[Line]], by: str, metrics: Sequence[Metric]) -> list[list[Line]]:
    """Mark the best values among the lines ``by`` one source, column by column; nothing where only one has a value.

    Values that look the same are equally good.
    """

    def looks(line: Line, column: int) -> float | None:
        value = line.cells[column].value
        # The paper's values have as many digits as were printed.
        return value if value is None or by != OURS else round(value, metric_of(line, column).decimals)

    def metric_of(line: Line, column: int) -> Metric:
        return line.metric or metrics[column]

    values: dict[tuple[str, int], list[float]] = defaultdict(list)
    for line in (line for block in blocks for line in block if line.by == by):
        for column in range(len(line.cells)):
            value = looks(line, column)
            if value is not None:
                values[metric_of(line, column).key, column].append(value)

    def marked(line: Line) -> Line:
        if line.by != by:
            return line
        cells = []
        for column, cell in enumerate(line.cells):
            metric = metric_of(line, column)
            rivals = values[metric.key, column]
            has_best = metric.better is not None and len(rivals) > 1
            best = (min if metric.better == "lower" else max)(rivals) if has_best else None
            cells.append(replace(cell, best=best is not None and looks(line, column) == best))
        return replace(line, cells=tuple(cells))

    return [[marked(line) for line in block] for block in blocks]


def _dagger_at_name(block: tuple[Line, ...]) -> tuple[Line, ...]:
    """Put the dagger on the method's name where all its numbers have one, as the paper does."""
    known = [cell for line in block for cell in line.cells if cell.value is not None]
    if not known or not all(cell.mark for cell in known):
        return block
    return tuple(
        replace(line, method=line.method + DAGGER, cells=tuple(replace(cell, mark="") for cell in line.cells))
        for line in block
    )
