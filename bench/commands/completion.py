"""``bgs-bench completion``: a script of the words that a shell completes; asking Python at each key takes seconds."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

from bench import registry
from bench.cli import COMMANDS, parser_of
from bench.config import RootConfig, options_of
from bench.discovery import load_plugins
from bench.protocol import Protocol
from bench.settings import documented
from bench.tables.named.find import table_names

_EXAMPLES = """examples:
  bgs-bench completion > ~/.local/share/bash-completion/completions/bgs-bench     # bash, from the next shell on
  bgs-bench completion > ~/.bgs-bench-completion                                  # zsh: in ~/.zshrc
      autoload -Uz compinit bashcompinit; compinit; bashcompinit; source ~/.bgs-bench-completion

Completed are commands, their options, plugins (stereo=...), presets and settings; to be made again after an upgrade or
with plugins of your own (--plugins FOLDER).
"""

# Bash breaks words at '=' (COMP_WORDBREAKS), so the word is read off the line, and what it has up to there is taken off
# the answers. What is no word of ours is completed as a file.
_SCRIPT = """\
_bgs_bench() {
    local line="${COMP_LINE:0:$COMP_POINT}" cut="" answer words
    local current="${line##* }" overrides="@overrides@"
    case "$([ "$COMP_CWORD" -gt 1 ] && echo "${COMP_WORDS[1]}")" in
        "") words="@commands@" ;;
@cases@
    esac
    COMPREPLY=()
    case "$COMP_WORDBREAKS:$current" in *=*:*=*) cut="${current%%=*}=" ;; esac
    for answer in $(compgen -W "$words" -- "$current"); do COMPREPLY+=("${answer#"$cut"}"); done
    case "${COMPREPLY[0]}" in *=) compopt -o nospace 2>/dev/null ;; esac
}
complete -o default -F _bgs_bench bgs-bench
"""


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser(
        "completion",
        help="a script that lets bash and zsh complete commands, plugins and settings",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--plugins", action="append", default=[], metavar="FOLDER", help="a folder of your own plugins")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the script; raises ``BenchError`` for a folder without plugins."""
    load_plugins(args.plugins)
    cases = []
    for command, parser in _nested(parser_of(COMMANDS)).items():
        words = _words(command, parser, args.plugins)
        takes_overrides = any("=" in str(action.metavar) for action in parser._actions if not action.option_strings)
        cases.append(f'        {command}) words="{" ".join(words)}{" $overrides" if takes_overrides else ""}" ;;')
    script = _SCRIPT.replace("@commands@", " ".join(COMMANDS)).replace("@cases@", "\n".join(cases))
    print(script.replace("@overrides@", " ".join(_overrides())), end="")
    return 0


def _nested(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """The sub-commands of a command, by name."""
    actions = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return dict(actions[0].choices) if actions else {}


def _words(command: str, parser: argparse.ArgumentParser, folders: Sequence[str]) -> list[str]:
    """A command's options, its sub-commands and theirs, and the names that it takes."""
    nested = _nested(parser)
    words = set(nested)
    for each in (parser, *nested.values()):
        shown = (action for action in each._actions if action.help != argparse.SUPPRESS)
        words |= {option for action in shown for option in action.option_strings if option.startswith("--")}
    if command in ("list", "new-plugin"):
        words |= {*registry.KINDS}
    if command in ("table", "reproduce"):
        words |= {*table_names(folders)}
    return sorted(words)


def _overrides() -> list[str]:
    """What can begin an override: parts by name, settings of a run, of the protocol and of every plugin."""
    chosen = [kind for kind in registry.CHOSEN_KINDS if kind not in registry.SEVERAL_AT_ONCE]
    words = {f"{group}={name}" for group in (*chosen, "protocol", "system") for name in options_of(group)}
    words |= {f"mapper.rasterizer={name}" for name in registry.names("rasterizer")}
    words |= {f"{kind}=[" for kind in registry.SEVERAL_AT_ONCE}
    settings = {setting.name for setting in documented(RootConfig)} - {*registry.KINDS, "system", "protocol"}
    words |= {f"{name}=" for name in settings} | {f"protocol.{setting.name}=" for setting in documented(Protocol)}
    for kind in registry.KINDS:
        for plugin in (registry.lookup(kind, name) for name in registry.names(kind)):
            prefix = f"mapper.{plugin.prefix}" if kind == "rasterizer" else plugin.prefix
            words |= {f"{prefix}.{setting.name}=" for setting in documented(plugin.config)}
    return sorted(words)
