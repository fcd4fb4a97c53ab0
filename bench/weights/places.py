"""Where a file of weights lies on this machine."""

from __future__ import annotations

import importlib.metadata
import os
from dataclasses import dataclass
from pathlib import Path

import pooch

from bench.errors import BenchError
from bench.weights.manifest import ByHand, FromPackage, Weights, entry


@dataclass(frozen=True)
class Located:
    """A file of weights, and in words where it was found."""

    path: Path
    where: str


def cache_root() -> Path:
    """The project's cache folder: ``$BGS_CACHE``, else the user's (``~/.cache/bgs-bench`` on Linux), else, of a user
    without a home folder, ``results/cache`` where the command is given. Not made here."""
    try:
        return Path(os.environ.get("BGS_CACHE") or pooch.os_cache("bgs-bench")).expanduser().absolute()
    except RuntimeError:  # no HOME, and an account that the system does not know
        return Path("results/cache").absolute()


def cached_path(weights: Weights) -> Path:
    """Where ``bgs-bench weights get`` puts the file."""
    return cache_root() / "weights" / weights.path


def locate(name: str) -> Located | None:
    """The file of the manifest's weights ``name``, if it is on this machine.

    Order: ``$BGS_WEIGHTS``, the cache folder, an installed copy of the package that carries it (its code is not
    imported). Raises ``BenchError`` for an unknown name, and where a file that must lie beside it is missing.
    """
    weights = entry(name)
    folders = [(cache_root() / "weights", "cache folder")]
    if os.environ.get("BGS_WEIGHTS"):
        folders.insert(0, (Path(os.environ["BGS_WEIGHTS"]).expanduser().absolute(), "$BGS_WEIGHTS"))
    for folder, where in folders:
        for relative in (weights.path, *weights.alternatives):
            path = folder / relative
            if path.is_file():
                _require_beside(weights, path)
                return Located(path, where)
    return _in_installed_package(weights)


def resolve(name: str) -> Path:
    """The file of the manifest's weights ``name``; raises ``BenchError`` that says how to get it where it is missing.

    Order: ``$BGS_WEIGHTS``, the cache folder, an installed copy of the package that carries it.
    """
    found = locate(name)
    if found is not None:
        return found.path
    looked = f"$BGS_WEIGHTS/{entry(name).path}" if os.environ.get("BGS_WEIGHTS") else "$BGS_WEIGHTS (not set)"
    raise BenchError(
        f"The weights '{name}' ({entry(name).purpose}) are not here: not in {looked}, not at "
        f"{cached_path(entry(name))}. {how_to_get(entry(name))}"
    )


def chosen(setting: str, value: str, name: str) -> Path:
    """The file that the ``value`` of a ``setting`` names, else that of ``resolve``; raises ``BenchError`` for none."""
    if not value:
        return resolve(name)
    path = Path(value).expanduser()
    if not path.is_file():
        raise BenchError(f"{setting}={value} is no file. Correct the path, or leave the setting out.")
    return path


def missing(name: str) -> str | None:
    """How to get the manifest's weights ``name`` where they are not on this machine; None where they are."""
    try:
        return None if locate(name) is not None else _as_clause(how_to_get(entry(name)))
    except BenchError as error:
        return str(error)


def _as_clause(sentence: str) -> str:
    return sentence[0].lower() + sentence[1:].rstrip(".")


def how_to_get(weights: Weights) -> str:
    """One sentence: the command that fetches the file, or the page, the file and the place for it."""
    if isinstance(weights.source, ByHand):
        return f"Fetch {weights.source.file}, from {weights.source.page}, and save it as {cached_path(weights)}."
    return f"Run `bgs-bench weights get {weights.name}`."


def _require_beside(weights: Weights, path: Path) -> None:
    for name in weights.beside:
        if not path.with_name(name).is_file():
            raise BenchError(f"The weights '{weights.name}' at {path} need {name} beside them. {how_to_get(weights)}")


def _in_installed_package(weights: Weights) -> Located | None:
    if not isinstance(weights.source, FromPackage):
        return None
    try:
        distribution = importlib.metadata.distribution(weights.source.project)
    except importlib.metadata.PackageNotFoundError:
        return None
    path = Path(str(distribution.locate_file(weights.source.member)))
    return Located(path, f"installed {weights.source.project}") if path.is_file() else None
