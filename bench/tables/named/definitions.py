"""The paper's tables: which rows, sequences and metrics they have, and which overrides make a run belong to a row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from bench.errors import BenchError, require_choice
from bench.tables.named.published import read_sequences

SEEDS = (0, 1, 2)
"""The paper averages three runs."""


@dataclass(frozen=True)
class Metric:
    """A metric by its key in run folders and in ``results/published``; ``decimals`` are those of our numbers.

    ``of_part`` False: what a run measured before it stopped early is no value of it (peak memory).
    """

    key: str
    title: str
    unit: str
    better: Literal["lower", "higher"]
    decimals: int
    of_part: bool = True


@dataclass(frozen=True)
class MethodRow:
    """A method. Our runs belong to it whose config agrees with all ``overrides`` and with none of ``never``.

    ``overrides`` None: no system of ours does this yet. ``published`` is the method's name in the paper's table;
    ``compared_with`` that of another one to which our numbers are compared.
    """

    label: str
    overrides: tuple[str, ...] | None = None
    never: tuple[str, ...] = ()
    published: str = ""
    compared_with: str = ""


@dataclass(frozen=True)
class NamedTable:
    """A table; ``across`` says what its columns are. ``about`` is what its caption says of the paper's numbers.

    ``protocol`` is how its runs are scored unless the user wants another.
    """

    name: str
    title: str
    dataset: str
    sequences: tuple[str, ...]
    metrics: tuple[Metric, ...]
    rows: tuple[MethodRow, ...]
    across: Literal["sequences", "metrics"]
    about: str = ""
    protocol: str = "paper"


@dataclass(frozen=True)
class Cell:
    """What has to be run for a place in the table: ``row`` is a method's label, ``column`` a sequence.

    ``overrides`` are those of ``bgs-bench run``, without the seed and without where the data set lies. ``blocked``
    says why nobody can run it, or is empty. ``defaults`` hold where the user does not say otherwise.
    """

    row: str
    column: str
    overrides: tuple[str, ...]
    blocked: str = ""
    defaults: tuple[str, ...] = ()

    def overrides_with(self, common: Sequence[str]) -> list[str]:
        """What a run of this cell is composed of, with a user's overrides ``common`` that are for all cells."""
        chosen = {each.partition("=")[0] for each in common}
        return [*(each for each in self.defaults if each.partition("=")[0] not in chosen), *common, *self.overrides]


ATE = Metric("ate_rmse_m", "ATE", "m", "lower", 3)
IMAGE = (
    Metric("psnr_db", "PSNR", "dB", "higher", 2),
    Metric("ssim", "SSIM", "", "higher", 3),
    Metric("lpips", "LPIPS", "", "lower", 3),
    Metric("depth_l1_cm", "Depth-L1", "cm", "lower", 1),
)
MEMORY = Metric("peak_memory_gb", "Memory", "GB", "lower", 2, of_part=False)
RUNTIME = (
    Metric("tracking_s_per_frame", "Tracking", "s/frame", "lower", 3),
    Metric("stereo_s_per_frame", "Stereo", "s/frame", "lower", 3),
    Metric("mapping_s_per_frame", "Mapping", "s/frame", "lower", 3),
    Metric("wall_s_per_frame", "Wall time", "s/frame", "lower", 3),
)
KITTI = ("03", "05", "06", "07", "09", "10")
KITTI_360 = ("0002", "0004", "0005", "0007", "0008", "0009")

# The two changes that make another row of nearly every table.
_NOT_PLAIN = ("sky=none", "stereo=lidar")
_ALL_TERMS = "loss=[rgb,ssim,geo,normal,smooth]"
_WEIGHTED = "loss.geo.edge_weighted=true"
_SAMPLED = "loss.geo.stride=2"
# Spelled out, so that a run of the ablation belongs to its own row alone.
_PAPER = ("system=bgs_slam_paper", _ALL_TERMS, _WEIGHTED, _SAMPLED)

_BASELINES = tuple(MethodRow(name, published=name) for name in ("Point-SLAM", "SplaTAM", "MonoGS"))
_OURS = "BGS-SLAM (Ours)"
_LIDAR_VARIANT = MethodRow("BGS-SLAM (LiDAR)", (*_PAPER, "stereo=lidar"), ("sky=none",), published="BGS-SLAM (LiDAR)")
_STEREO_SYSTEMS = (
    MethodRow(_OURS, _PAPER, _NOT_PLAIN, published=_OURS),
    MethodRow("bgs_slam", ("system=bgs_slam",), _NOT_PLAIN, compared_with=_OURS),
    MethodRow("bgs_slam_fast", ("system=bgs_slam_fast",), _NOT_PLAIN, compared_with=_OURS),
)
_MAIN_ROWS = (*_BASELINES, _LIDAR_VARIANT, *_STEREO_SYSTEMS)

_ABLATION_ROWS = (
    MethodRow("w/o ss (no sky segmentation)", (*_PAPER, "sky=none"), ("stereo=lidar",), "w/o ss"),
    MethodRow(
        "w/o wd (no geometric loss)", ("system=bgs_slam_paper", "loss=[rgb,ssim,normal,smooth]"), _NOT_PLAIN, "w/o wd"
    ),
    MethodRow(
        "w/o nl (no normal loss)",
        ("system=bgs_slam_paper", "loss=[rgb,ssim,geo,smooth]", _WEIGHTED, _SAMPLED),
        _NOT_PLAIN,
        "w/o nl",
    ),
    MethodRow(
        "w/o sl (no smoothness loss)",
        ("system=bgs_slam_paper", "loss=[rgb,ssim,geo,normal]", _WEIGHTED, _SAMPLED),
        _NOT_PLAIN,
        "w/o sl",
    ),
    MethodRow(
        "with ds (every pixel supervised)",
        ("system=bgs_slam_paper", _ALL_TERMS, _WEIGHTED, "loss.geo.stride=1"),
        _NOT_PLAIN,
        "with ds",
    ),
    MethodRow(
        "w/o gradient weight",
        ("system=bgs_slam_paper", _ALL_TERMS, "loss.geo.edge_weighted=false", _SAMPLED),
        _NOT_PLAIN,
        compared_with="Ours",
    ),
    MethodRow("Ours (full)", _PAPER, _NOT_PLAIN, "Ours"),
)


def _backbone(plugin: str, published: str = "", label: str = "") -> MethodRow:
    compared = "" if published else "MonSter-M"
    return MethodRow(label or published, (*_PAPER, f"stereo={plugin}"), ("sky=none",), published, compared)


_BACKBONE_ROWS = (
    _backbone("igev", "IGEV"),
    _backbone("igev_plusplus", "IGEV++"),
    _backbone("tcsm", "TCSM"),
    _backbone("monster_k", "MonSter-K"),
    _backbone("mocha", "Mocha"),
    _backbone("foundation_stereo", "FoundationStereo"),
    _backbone("monster_m", "MonSter-M"),
    _backbone("psmnet", label="PSMNet"),
    _backbone("anynet", label="AnyNet"),
    _backbone("sgbm", label="SGBM"),
)

_MAIN_METRICS = (ATE, *IMAGE)
_300_FRAMES = "The paper ran the methods with a dagger on the first 300 frames of each sequence, and MonoGS as RGB-D."

TABLES = {
    table.name: table
    for table in (
        NamedTable(
            "main_kitti",
            "Trajectory, rendering and geometry on KITTI odometry",
            "kitti",
            KITTI,
            _MAIN_METRICS,
            _MAIN_ROWS,
            "sequences",
            _300_FRAMES,
        ),
        NamedTable(
            "main_kitti360",
            "Trajectory, rendering and geometry on KITTI-360",
            "kitti360",
            KITTI_360,
            _MAIN_METRICS,
            _MAIN_ROWS,
            "sequences",
            _300_FRAMES,
        ),
        NamedTable(
            "ablation",
            "Ablation of the system's parts on KITTI 03",
            "kitti",
            ("03",),
            IMAGE,
            _ABLATION_ROWS,
            "metrics",
        ),
        NamedTable(
            "backbones",
            "Stereo networks in the system on KITTI 03",
            "kitti",
            ("03",),
            IMAGE,
            _BACKBONE_ROWS,
            "metrics",
            "In the paper IGEV, IGEV++, TCSM and MonSter-K were trained on KITTI, the others on mixtures of data sets.",
        ),
        NamedTable(
            "memory",
            "Peak memory on KITTI odometry",
            "kitti",
            KITTI,
            (MEMORY,),
            (MethodRow("SplaTAM", published="SplaTAM"), *_STEREO_SYSTEMS),
            "sequences",
            "The paper's memory is that of an NVIDIA A40 with 48 GB; a cross means that this was too little.",
        ),
        NamedTable(
            "runtime",
            "Time a frame on KITTI odometry",
            "kitti",
            KITTI,
            RUNTIME,
            _STEREO_SYSTEMS,
            "sequences",
            "The paper's times are those of an NVIDIA A40, averaged over sequences that it does not name.",
        ),
    )
}

DIALECTS = "dialects"
"""A table of its own kind, of any runs: see ``bench.tables.named.dialects``."""
TABLE_NAMES = (*TABLES, DIALECTS)


def named_table(name: str) -> NamedTable:
    """The table of this name; raises ``BenchError`` with the names there are."""
    if name == DIALECTS:
        raise BenchError(
            f"The table {DIALECTS} has no cells of its own: it is of any runs. Make some with `bgs-bench run "
            "'evaluator=[ate,image,depth_l1,resources,dialects]' ...` or `bgs-bench reproduce main_kitti "
            f"'evaluator=[...]'`, then `bgs-bench table {DIALECTS} RUN_FOLDER ...`."
        )
    return TABLES[require_choice("table", name, TABLES)]


def cells(table: NamedTable) -> list[Cell]:
    """Every place of the table that runs of ours can fill, row by row; each wants one run for each of ``SEEDS``."""
    facts = read_sequences(table.dataset)
    return [
        Cell(
            row.label,
            sequence,
            (f"dataset={table.dataset}", f"dataset.sequence={sequence}", *row.overrides),
            facts[sequence].withheld,
            (f"protocol={table.protocol}",),
        )
        for row in table.rows
        if row.overrides is not None
        for sequence in table.sequences
    ]
