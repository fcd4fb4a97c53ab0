"""What a config dataclass says about its settings: each field's documentation stands below it as a string; and whether
their numbers are numbers to work with."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import math
import textwrap
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from bench.errors import BenchError

LARGEST = 2**31 - 1
"""The largest whole number that a setting can be: what 32 bits hold."""


@dataclass(frozen=True)
class Setting:
    """One setting: its dotted name below the config (``loops.min_way_m``), its type as written, what it is when not
    given (``dataclasses.MISSING``: it must be given), and what it means ("" where nobody says)."""

    name: str
    type: str
    default: Any
    meaning: str


def documented(config: type) -> list[Setting]:
    """The settings of a config dataclass, inherited and nested ones too, in the order of its fields.

    A meaning is the string literal below the field; a field that is declared again without one keeps the inherited
    meaning. A field that is a plugin (``plugin_field``) has its kind as type and a name as default. ``name`` of a
    plugin's config is left out: the registry fills it in. ``OSError`` where there is no source.
    """
    written: dict[str, str] = {}
    meanings: dict[str, str] = {}
    for base in reversed(config.__mro__):
        if dataclasses.is_dataclass(base):
            for name, annotation, meaning in _fields_in_source(base):
                written[name] = annotation
                meanings[name] = meaning or meanings.get(name, "")
    hints = typing.get_type_hints(config)
    settings = []
    for field in dataclasses.fields(config):
        if field.name == "name":
            continue
        if "plugin" in field.metadata:
            kind, chosen = field.metadata["plugin"], field.metadata["default"]
            settings.append(Setting(field.name, kind, chosen, meanings[field.name]))
            continue
        if dataclasses.is_dataclass(hints[field.name]):
            inner = documented(hints[field.name])
            settings += [dataclasses.replace(each, name=f"{field.name}.{each.name}") for each in inner]
            continue
        default = field.default if field.default_factory is dataclasses.MISSING else field.default_factory()
        settings.append(Setting(field.name, written[field.name], default, meanings[field.name]))
    return settings


def check_numbers(where: str, config: Any) -> None:
    """Raise ``BenchError`` for the first setting, nested and listed ones too, that is NaN, infinite or beyond 32 bits.

    ``where`` is how the user begins the settings' names, for example ``"mapper"``. A float may be infinite where its
    field says so: ``field(default=..., metadata={"infinite": True})``; defaults are always taken. What else a number
    must be is up to the config's own ``__post_init__``.
    """
    for field in dataclasses.fields(config):
        value, name = getattr(config, field.name), f"{where}.{field.name}"
        if dataclasses.is_dataclass(value):
            # A setting that is a plugin has been checked as such.
            if "plugin" not in field.metadata:
                check_numbers(name, value)
            continue
        for each in value if isinstance(value, (list, tuple)) else [value]:
            if isinstance(each, float) and not math.isfinite(each):
                allowed = field.metadata.get("infinite") and not math.isnan(each)
                if not allowed and repr(each) != repr(field.default):  # NaN differs from itself
                    shown = list(value) if isinstance(value, tuple) else value
                    raise BenchError(f"{name}={shown} is no number to work with; give a finite one.")
            elif isinstance(each, int) and abs(each) > LARGEST:
                raise BenchError(f"{name}={each} is too large; the most is {LARGEST}.")


def _fields_in_source(config: type) -> Iterator[tuple[str, str, str]]:
    """Name, type and documentation of each field that the class itself declares."""
    (body,) = ast.parse(textwrap.dedent(inspect.getsource(config))).body
    assert isinstance(body, ast.ClassDef)
    for statement, below in zip(body.body, [*body.body[1:], None], strict=True):
        if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name):
            meaning = ""
            if isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
                meaning = " ".join(str(below.value.value).split())
            yield statement.target.id, ast.unparse(statement.annotation), meaning
