"""One hash for everything that a run's result depends on: config, code, packages, network weights, machine."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path

import bench
from bench.cache.code_version import code_version
from bench.machine import what_computes
from bench.weights.checksum import sha256_of


def fingerprint(config_hash: str, plugins: Iterable[type], weights: Mapping[str, Path]) -> str:
    """Hexadecimal SHA-256. ``plugins`` are the classes in use, ``weights`` the files of the networks.

    Any change in the project's own files counts, since no list of those that matter would stay right.
    """
    parts = {
        "config": config_hash,
        "project": _project_code(),
        "plugins": sorted(code_version(plugin) for plugin in plugins),
        "weights": {what: sha256_of(path) for what, path in weights.items()},
        "machine": what_computes(),
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


@lru_cache(maxsize=1)
def _project_code() -> str:
    """SHA-256 over every source file and compiled module of the packages ``bench`` and ``plugins``."""
    root = Path(bench.__file__).parent.parent
    digest = hashlib.sha256()
    for package in ("bench", "plugins"):
        for file in sorted((root / package).rglob("*")):
            if file.suffix in (".py", ".so") and "__pycache__" not in file.parts:
                digest.update(f"{file.relative_to(root)}\n".encode())
                digest.update(file.read_bytes())
    from bench import _native  # its file lies elsewhere in an editable installation

    digest.update(Path(_native.__file__).read_bytes())
    return digest.hexdigest()
