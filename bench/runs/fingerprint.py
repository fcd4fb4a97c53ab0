"""One hash for everything that a run's result depends on: config, code, packages, network weights, machine."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path

from bench.code_version import code_version, project_version
from bench.machine import what_computes
from bench.weights.checksum import sha256_of


def fingerprint(config_hash: str, plugins: Iterable[type], weights: Mapping[str, Path]) -> str:
    """Hexadecimal SHA-256. ``plugins`` are the classes in use, ``weights`` the files of the networks.

    Any change in the project's own files counts, since no list of those that matter would stay right.
    """
    parts = {
        "config": config_hash,
        "project": project_version(),
        "plugins": sorted(code_version(plugin) for plugin in plugins),
        "weights": {what: sha256_of(path) for what, path in weights.items()},
        "machine": what_computes(),
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
