"""Where data sets lie on this machine."""

from __future__ import annotations

import os
from pathlib import Path

from bench.data.manifest import entry
from bench.errors import BenchError
from bench.weights.places import cache_root


def data_root() -> Path:
    """The folder of all data sets: ``$BGS_DATA``, else ``data`` in the project's cache folder. Not made here."""
    given = os.environ.get("BGS_DATA")
    return Path(given).expanduser().absolute() if given else cache_root() / "data"


def folder_of(name: str) -> Path:
    """Where ``bgs-bench data get NAME`` puts a data set, and where its loader looks when ``dataset.root`` is empty."""
    return data_root() / entry(name).folder


def existing_root(text: str, name: str, holds: str) -> Path:
    """The folder that ``dataset.root`` is, ``folder_of(name)`` where it is empty; ``holds`` is for the message.

    Raises ``BenchError`` where there is no such folder.
    """
    root = Path(text).expanduser() if text else folder_of(name)
    if not root.is_dir():
        raise BenchError(
            f"dataset.root={root}: this folder does not exist. Give the folder that holds {holds}, "
            f"dataset.root=FOLDER, or fetch it: `bgs-bench data get {name}` says how."
        )
    return root
