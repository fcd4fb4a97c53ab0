"""Taking out of recorded values where things lay on the machine that made them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

from bench.runs.config_file import NO_PART_OF_THE_RUN

# An absolute path inside a sentence, up to its last part. Not the "/" of "s/frame", of a URL or of "</b>".
_PATH = re.compile(r"(?<![\w.~:/<])/(?:[^\s/'\",;:()]+/)*([^\s/'\",;:()]+)")


def portable_text(text: str) -> str:
    """A sentence with each absolute path in it replaced by its last part."""
    return _PATH.sub(r"\1", text) if "/" in text else text


def portable(value: Any) -> Any:
    """Plain data (dicts, lists, numbers, strings) as a copy whose strings went through ``portable_text``."""
    if isinstance(value, str):
        return portable_text(value)
    if isinstance(value, dict):
        return {key: portable(each) for key, each in value.items()}
    if isinstance(value, list):
        return [portable(each) for each in value]
    return value


def portable_config(config: Mapping[str, Any]) -> dict[str, Any]:
    """What of a resolved config says how a result was made: without where the run and its data set lie.

    Other values that are absolute paths (network weights, images) are reduced to their last part, and an infinite
    number is the text "inf", since JSON has none: from a record file it comes back as it is here.
    """
    kept = {key: _without_folders(value) for key, value in config.items() if key not in NO_PART_OF_THE_RUN}
    dataset = kept.get("dataset")
    if isinstance(dataset, dict):
        dataset.pop("root", None)
    return kept


def _without_folders(value: Any) -> Any:
    """As ``portable``, for values that are a path as a whole, which may have blanks in it."""
    if isinstance(value, str):
        return PurePath(value).name if value.startswith("/") else value
    if isinstance(value, float) and math.isinf(value):
        return str(value)
    if isinstance(value, dict):
        return {key: _without_folders(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_without_folders(each) for each in value]
    return value
