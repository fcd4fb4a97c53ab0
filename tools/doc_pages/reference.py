"""The reference pages: what each command prints with ``--help``, and every plugin with its settings, from the code."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator

from bench import registry
from bench.cli import COMMANDS, parser_of
from bench.commands.list import typed
from bench.config import RootConfig
from bench.protocol import Protocol
from bench.registry import Plugin
from bench.settings import Setting, documented

_WIDTH = "110"


def commands_text() -> str:
    """A heading a command, below it what its ``--help`` prints."""
    os.environ["COLUMNS"] = _WIDTH
    parts = []
    for name, parser in _commands(parser_of(COMMANDS)):
        parts += [f"## bgs-bench {name}", f"```text\n{parser.format_help().rstrip()}\n```"]
    return "\n\n".join(parts)


def _commands(parser: argparse.ArgumentParser, before: str = "") -> Iterator[tuple[str, argparse.ArgumentParser]]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, command in action.choices.items():
                yield f"{before}{name}", command
                yield from _commands(command, f"{before}{name} ")


def settings_text() -> str:
    """The settings of a run that belong to no plugin, and those of the protocol."""
    parts = ["# Settings of a run", "The plugins' own settings are on the pages of their kinds."]
    parts += [
        "## The run",
        _table(documented(RootConfig), ""),
        "## The protocol",
        _table(documented(Protocol), "protocol."),
    ]
    return "\n\n".join(parts) + "\n"


def kind_text(kind: str) -> str:
    """The page of a kind: each plugin of the repository, what it is, its file and its settings."""
    several = kind in registry.SEVERAL_AT_ONCE
    chosen = f"`{kind}=[a,b]`, several at once" if several else f"`{kind}=NAME`"
    if kind not in registry.CHOSEN_KINDS:
        chosen = f"`mapper.{kind}=NAME`"
    plugins = [registry.lookup(kind, name) for name in registry.names(kind)]
    parts = [f"# {kind.capitalize()}", f"Chosen by {chosen}; `bgs-bench list {kind}` says which can run here."]
    return "\n\n".join([*parts, *map(_plugin, plugins)]) + "\n"


def _plugin(plugin: Plugin) -> str:
    settings = documented(plugin.config)
    below = _table(settings, f"{plugin.prefix}.") if settings else "No settings."
    module = plugin.cls.__module__.replace(".", "/")
    return f"## {plugin.name}\n\n{plugin.summary}\n\nIn `{module}.py`.\n\n{below}"


def _table(settings: list[Setting], prefix: str) -> str:
    rows = ["| setting | default | |", "|---|---|---|"]
    for setting in settings:
        meaning = setting.meaning.replace("``", "`").replace("|", "\\|").replace("\n", " ").replace("<", "&lt;")
        kind = f"*{setting.type}*. " if setting.type else ""
        kind = kind.replace("|", "\\|")
        default = typed(setting.default)
        shown = f"`{default}`" if default else ""
        rows.append(f"| `{prefix}{setting.name}` | {shown} | {kind}{meaning} |")
    return "\n".join(rows)
