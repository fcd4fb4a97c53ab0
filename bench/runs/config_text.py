"""Parsing the YAML text of many ``config.yaml`` files fast: the runs of a sweep have most of their text in common."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import yaml  # type: ignore[import-untyped]  # comes with omegaconf

# libyaml's parser, where PyYAML was built with it, is ten times as fast.
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def parse_config(text: str) -> dict[str, Any]:
    """The settings in the text of a resolved config, as the bench writes it; raises ``yaml.YAMLError`` for other text.

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
    return yaml.load(block, Loader=_LOADER)
