"""Where the files are that are no Python: presets and tables, and published numbers."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).parent


def config_folder() -> Path:
    """Where the YAML files are: inside the installed package, else beside it in the checkout."""
    return _first(_PACKAGE / "conf", _PACKAGE.parent / "conf")


def published_folder() -> Path:
    """Where the papers' CSV files are: inside the installed package, else in the checkout."""
    return _first(_PACKAGE / "published", _PACKAGE.parent / "results" / "published")


def _first(installed: Path, in_checkout: Path) -> Path:
    return installed if installed.is_dir() else in_checkout
