"""A saved run under another protocol: a run folder of its own beside it, with the same pictures and trajectory."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.config import compose_run, hash_of
from bench.errors import BenchError
from bench.evaluation.saved_run import SavedRunFolder
from bench.runs.config_file import read_config, write_config
from bench.runs.folder import METRICS_FILE, PER_FRAME_FILE, PLOT_FILE, SCORES_FILE

_OF_THE_RUN = ("holdout_every", "holdout_remainder", "rendered_depth")
"""Settings of the protocol that a run obeys while it maps and renders: scoring can't change them afterwards."""
# Copied, since they are small and may be written again; what else there is, the map, is linked.
_TEXTS = (".csv", ".json", ".jsonl", ".txt", ".yaml")
_OF_SCORING = (METRICS_FILE, PER_FRAME_FILE, PLOT_FILE, SCORES_FILE)


def copy_for(run: SavedRunFolder, overrides: Sequence[str], out: Path | None = None) -> Path:
    """Make the folder of ``run`` under the protocol and evaluators that ``overrides`` ask for; returns its path.

    ``out`` None: beside the run, named by the hash of the new config, which is where ``bgs-bench run`` would have put a
    run with this protocol. Pictures are hard links where the file system has them, else copies. Where the folder is
    there already, it is taken. Raises ``BenchError`` for overrides of anything else, for a protocol that this run can't
    be scored under, and for a place that holds something else.
    """
    if run.status.is_alive():
        raise BenchError(f"{run.path} is still running. Score it when it is done.")
    config = _changed(run, overrides)
    _require_same_run(run, config["protocol"])
    config_hash = hash_of(config)
    target = out or run.path.resolve().parent / config_hash
    if config_hash == run.config_hash:
        raise BenchError(f"{run.path} was made under these settings already; leave them out to score it again.")
    if target.exists():
        known = read_config(target) if target.is_dir() else None
        if known is None or known[1] != config_hash:
            raise BenchError(f"{target} holds something else. Give --out another folder.")
        return target
    config["output"] = str(target.absolute())
    _copy(run, target, config, config_hash)
    return target


def _changed(run: SavedRunFolder, overrides: Sequence[str]) -> dict[str, Any]:
    """The run's config with the protocol and the evaluators that ``overrides`` ask for."""
    keys = [override.lstrip("+~").partition("=")[0] for override in overrides]
    for override, key in zip(overrides, keys, strict=True):
        if key.split(".")[0] not in ("protocol", "evaluator"):
            raise BenchError(
                f"{override}: scoring a saved run again can change its protocol and its evaluators (protocol=paper, "
                "protocol.ssim=3dgs, evaluator=[ate,dialects]); anything else needs a new run."
            )
    common = []
    if "evaluator" not in keys:
        evaluators = [str(name) for name in run.config.get("evaluator") or {}]
        for name in evaluators:
            run.require("evaluator", name)
        common = [f"evaluator=[{','.join(evaluators)}]"]
    composed = compose_run([*common, *overrides]).values
    changed = dict(run.config)
    for part in ("protocol", "evaluator"):
        saved: Mapping[str, Any] = run.config.get(part) or {}
        if part in keys:
            changed[part] = composed[part]
        else:
            changed[part] = _with(saved, composed[part], [key for key in keys if key.startswith(f"{part}.")])
    return changed


def _with(saved: Mapping[str, Any], composed: Mapping[str, Any], keys: Sequence[str]) -> dict[str, Any]:
    """``saved`` with the values at these dotted keys (their first part left out) taken from ``composed``."""
    result = {key: dict(value) if isinstance(value, Mapping) else value for key, value in saved.items()}
    for key in keys:
        *path, last = key.split(".")[1:]
        into, source = result, composed
        for part in path:
            into, source = into.setdefault(part, {}), source[part]
        into[last] = source[last]
    return result


def _require_same_run(run: SavedRunFolder, protocol: Mapping[str, Any]) -> None:
    stamp = {name: getattr(run.protocol, name) for name in _OF_THE_RUN}
    # Which remainder is kept out says nothing where nothing is.
    held_out = bool(stamp["holdout_every"]) or bool(protocol.get("holdout_every"))
    for name in _OF_THE_RUN:
        if protocol.get(name, stamp[name]) == stamp[name] or (name == "holdout_remainder" and not held_out):
            continue
        raise BenchError(
            f"protocol.{name}={protocol[name]}: this run was mapped and rendered with {stamp[name]}. Run it again with "
            "that protocol, or keep it as it was."
        )
    rendered = run.rendered("left")
    if protocol.get("right_view") and not run.protocol.right_view and rendered and not run.rendered("right"):
        raise BenchError(
            "protocol.right_view=true: this run saved no right views. Run it again with that protocol, or say "
            "protocol.right_view=false."
        )


def _copy(run: SavedRunFolder, target: Path, config: dict[str, Any], config_hash: str) -> None:
    """All files of the run but its scores, in a folder that gets its name when it is complete."""
    staging = target.parent / f".scoring-{os.getpid()}-{target.name}"
    try:
        staging.mkdir(parents=True)
        for source in sorted(run.path.iterdir()):
            if source.is_file() and not source.name.startswith(".") and source.name not in _OF_SCORING:
                (shutil.copy2 if source.suffix in _TEXTS else _link)(source, staging / source.name)
        for source in sorted(run.path.glob("views/*/*/*.png")):
            if re.fullmatch(r"\d{6,}", source.stem):
                _link(source, staging / source.relative_to(run.path))
        write_config(staging, config, config_hash)
        os.replace(staging, target)
    except OSError as error:
        raise BenchError(f"Can't make {target}: {error.strerror or error}. Give --out another place.") from error
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _link(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source, target)
    except OSError:  # another file system, or one without links
        shutil.copy2(source, target)
