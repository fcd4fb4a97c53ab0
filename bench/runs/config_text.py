"""Parsing the YAML text of many ``config.yaml`` files fast: the runs of a sweep have most of their text in common."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

from bench.io.yaml_files import parse_yaml


def parse_config(text: str) -> dict[str, Any]:
    """The settings in the text of a resolved config, as the bench writes it; raises for other text what
    ``parse_yaml`` raises.

    What lies below a top-level key is shared between calls and must not be changed.
    """
    config: dict[str, Any] = {}
    for block in _top_level_blocks(text):
        part = _parse(block)
        if isinstance(part, dict):
            config |= part
    return config


def _top_level_blocks(text: str) -> Iterator[str]:
    """The text of each top-level key; the bench's YAML has nothing else at the margin but list items and comments."""
    block: list[str] = []
    for line in text.splitlines(keepends=True):
        if line[0] not in " -#\n" and block:
            yield "".join(block)
            block = []
        block.append(line)
    if block:
        yield "".join(block)


@lru_cache(maxsize=4096)
def _parse(block: str) -> Any:
    return parse_yaml(block)
