"""YAML that others wrote: plain data only, without aliases and nested no deeper than settings are."""

from __future__ import annotations

import re
from typing import Any

import yaml  # type: ignore[import-untyped]  # comes with omegaconf

# libyaml's parser, where PyYAML was built with it, is ten times as fast.
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_DEEPEST = 50
# Far to the right, or lists of lists of lists in one line.
_DEEP = re.compile(rf" {{{_DEEPEST}}}|(?:[-?:][ \t]+){{20}}")


def parse_yaml(text: str) -> Any:
    """The content of YAML text; no tag in it makes anything but plain data.

    Raises ``ValueError`` for text that is no YAML, for aliases (a few lines of them stand for gigabytes) and for what
    is nested without measure.
    """
    try:
        _require_modest(text)
        return yaml.load(text, Loader=_LOADER)
    except yaml.YAMLError as error:
        raise ValueError(" ".join(str(error).split())) from error


def _require_modest(text: str) -> None:
    # Parsing into events takes as long as loading, so only what may have either is looked at.
    may_be_deep = text.count("[") + text.count("{") > _DEEPEST or _DEEP.search(text)
    if not may_be_deep and not ("&" in text and "*" in text):
        return
    depth = 0
    for event in yaml.parse(text, Loader=_LOADER):
        if isinstance(event, yaml.AliasEvent):
            raise ValueError("it has an alias (*name); write the value out")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEEPEST:
            raise ValueError(f"it is nested more than {_DEEPEST} deep")
