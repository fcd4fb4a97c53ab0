"""Keeping once what many nested dicts have in common."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any


def in_common(several: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The keys, at any depth, under which all dicts have the same value; empty for none or a single dict."""
    if len(several) < 2:
        return {}
    first, *others = several
    found = {}
    for key, value in first.items():
        if not all(key in other for other in others):
            continue
        values = [other[key] for other in others]
        if all(_same(value, other) for other in values):
            found[key] = value
        elif isinstance(value, dict) and all(isinstance(other, dict) for other in values):
            below = in_common([value, *values])
            found |= {key: below} if below else {}
    return found


def without(one: dict[str, Any], common: dict[str, Any]) -> dict[str, Any]:
    """``one`` without what ``common`` has of it."""
    rest = {}
    for key, value in one.items():
        if key not in common:
            rest[key] = value
        elif not _same(value, common[key]):
            below = without(value, common[key])
            rest |= {key: below} if below else {}
    return rest


def together(common: dict[str, Any], rest: dict[str, Any]) -> dict[str, Any]:
    """The dict that ``common`` and ``rest`` were made of, with sorted keys."""
    merged = {}
    for key in sorted(common.keys() | rest.keys()):
        if key in common and key in rest:
            merged[key] = together(common[key], rest[key])
        else:
            merged[key] = rest[key] if key in rest else common[key]
    return merged


def _same(one: Any, other: Any) -> bool:
    """Equal, and not only as 1, 1.0 and True are."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_same(value, other[key]) for key, value in one.items())
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(_same(a, b) for a, b in zip(one, other, strict=True))
    return type(one) is type(other) and bool(one == other)
