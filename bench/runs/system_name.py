"""Which runs are another system's, scored from its output: what a run's config says of that."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

SECTION = "foreign"
"""The part of ``config.yaml`` that such a run has in place of stereo, tracker, mapper and the like."""


def external_name(config: Mapping[str, Any]) -> str | None:
    """Name of the system whose output a run with this config is, or None for a run of the bench's own."""
    section = config.get(SECTION)
    name = section.get("name") if isinstance(section, Mapping) else None
    return str(name) if name else None


def system_name(config: Mapping[str, Any]) -> str | None:
    """What tables call the system: the other system's name, or that of our system; None where the config has none."""
    system = config.get("system")
    name = external_name(config) or (system.get("name") if isinstance(system, Mapping) else system)
    return str(name) if name not in (None, "") else None


def is_content(key: str) -> bool:
    """Whether a setting (by dotted name) says what the scored output was: runs that differ in it can be averaged."""
    part, _, name = key.partition(".")
    return part == SECTION and name.partition(".")[0] not in ("name", "read_as")


def same_system(name: str, label: str) -> bool:
    """Whether two names are of the same system; capitals, blanks, hyphens and underscores don't matter."""
    one, other = ("".join(c for c in text.lower() if c.isalnum()) for text in (name, label))
    return one == other != ""
