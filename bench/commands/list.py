"""``bgs-bench list``: every plugin, whether it can run here, and why not; the settings of one plugin, or of a run."""

from __future__ import annotations

import argparse
import dataclasses
import shutil
import textwrap
from typing import Any

from bench import registry
from bench.config import RootConfig, compose_run
from bench.discovery import load_plugins
from bench.errors import BenchError, require_choice
from bench.protocol import Protocol
from bench.registry import SEVERAL_AT_ONCE, Plugin
from bench.settings import Setting, documented

_OF_A_RUN = "run"


_EXAMPLES = """examples:
  bgs-bench list                       # every plugin
  bgs-bench list stereo                # those that can stand at stereo=
  bgs-bench list stereo sgbm           # its settings, defaults and what they mean
  bgs-bench list run                   # the settings of a run
  bgs-bench list stereo --plugins mine
"""


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser(
        "list",
        help="every plugin, available or not and why; the settings of one",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    kinds = ", ".join(registry.KINDS)
    parser.add_argument("kind", nargs="?", help=f"one of {kinds}; default: all; '{_OF_A_RUN}': the settings of a run")
    parser.add_argument("name", nargs="?", help="a plugin of this kind: its settings, defaults and what they mean")
    parser.add_argument("--plugins", action="append", default=[], metavar="FOLDER", help="a folder of your own plugins")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print one line per plugin and one per file that failed to import; of one plugin or a run, the settings.

    Raises ``BenchError`` for an unknown kind or name.
    """
    if args.kind is not None:
        require_choice("kind", args.kind, [*registry.KINDS, _OF_A_RUN])
    load_plugins(args.plugins)
    if args.kind == _OF_A_RUN:
        if args.name is not None:
            raise BenchError(
                f"`bgs-bench list {_OF_A_RUN}` takes no name; for a plugin's settings give its kind first."
            )
        _print_settings(_settings_of_a_run())
    elif args.name is not None:
        _print_plugin(registry.lookup(args.kind, args.name))
    else:
        _print_plugins(registry.KINDS if args.kind is None else (args.kind,))
    return 0


def _print_plugins(kinds: tuple[str, ...]) -> None:
    plugins = [registry.lookup(kind, name) for kind in kinds for name in registry.names(kind)]
    width = max((len(plugin.name) for plugin in plugins), default=0)
    for plugin in plugins:
        state = _hindrance(plugin).replace("unavailable: ", "unavailable  ") or f"available    {plugin.summary}"
        print(f"{plugin.kind:<10} {plugin.name:<{width}}  {state}")
    # A file that failed to import may hold any kind of plugin, so each listing shows it.
    for file, why in sorted(registry.broken_files.items()):
        print(f"{'broken':<10} {file}: {' '.join(why.split())}")


def _hindrance(plugin: Plugin) -> str:
    """What is missing before the plugin runs as it is, and how to get it; empty where nothing is."""
    reason, weights = plugin.unavailable_reason(), plugin.missing_weights()
    if reason is not None:
        return f"unavailable: {' '.join(reason.split())}"
    return f"needs weights: {' '.join(weights.split())}" if weights else ""


def _print_plugin(plugin: Plugin) -> None:
    print(f"{plugin.kind}={plugin.name}: {plugin.summary}")
    print(f"file: {plugin.file}")
    print(_hindrance(plugin) or "available")
    settings = _named(plugin.prefix, documented(plugin.config))
    print() if settings else print("no settings")
    _print_settings(settings)


def _settings_of_a_run() -> list[Setting]:
    """The root's settings with what a run without overrides has, and those of the protocol."""
    values = compose_run([]).values
    settings = []
    for setting in documented(RootConfig):
        part: Any = values.get(setting.name)
        if setting.name in (*registry.KINDS, "protocol"):
            part = None if part is None else list(part) if setting.name in SEVERAL_AT_ONCE else part["name"]
            setting = dataclasses.replace(setting, type="")
        settings.append(setting if part is None else dataclasses.replace(setting, default=part))
    return settings + _named("protocol", documented(Protocol))


def _named(prefix: str, settings: list[Setting]) -> list[Setting]:
    return [dataclasses.replace(setting, name=f"{prefix}.{setting.name}") for setting in settings]


def _print_settings(settings: list[Setting]) -> None:
    """Name, type and default as they are typed, and the meaning below, wrapped to the terminal."""
    columns = min(shutil.get_terminal_size().columns, 120)
    for setting in settings:
        print(f"{setting.name}={typed(setting.default)}" + (f"  ({setting.type})" if setting.type else ""))
        meaning = setting.meaning.replace("``", "") or "(not documented)"
        print(textwrap.fill(meaning, columns, initial_indent="    ", subsequent_indent="    ", break_on_hyphens=False))


def typed(value: Any) -> str:
    """A default as the command line takes it."""
    if value is dataclasses.MISSING:
        return "???"
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, list | tuple):
        return f"[{','.join(typed(each) for each in value)}]"
    return str(value)
