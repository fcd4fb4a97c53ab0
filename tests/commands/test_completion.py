"""``bgs-bench completion``: its script, asked by bash itself."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from bench.cli import COMMANDS, main

_ASK = """
COMP_LINE="$LINE" COMP_POINT=${#LINE} COMP_WORDS=($LINE) COMP_CWORD=$CWORD
_bgs_bench
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.fixture(scope="module")
def script() -> str:
    with pytest.MonkeyPatch.context() as patch:
        printed: list[str] = []
        patch.setattr("builtins.print", lambda text, **_: printed.append(text))
        assert main(["completion"]) == 0
    return printed[0]


_LINES = [
    ("bgs-bench ", 1, set(COMMANDS)),
    ("bgs-bench rep", 1, {"report", "reproduce"}),
    ("bgs-bench run stereo=sg", 4, {"sgbm"}),  # bash puts it behind the '='
    ("bgs-bench run tracker.loop_cl", 2, {"tracker.loop_closure="}),
    ("bgs-bench run loss.geo.wei", 2, {"loss.geo.weight="}),
    ("bgs-bench run system=bgs_slam_l", 4, {"bgs_slam_letter"}),
    ("bgs-bench run --dry", 2, {"--dry-run"}),
    ("bgs-bench reproduce small", 2, {"small_motion"}),
    ("bgs-bench weights li", 2, {"list"}),
    ("bgs-bench list keyf", 2, {"keyframer"}),
    ("bgs-bench map stereo=", 3, {""}),
]


@pytest.mark.parametrize(("line", "word", "offered"), _LINES)
def test_bash_is_offered(line: str, word: int, offered: set[str], script: str) -> None:
    given = {"LINE": line, "CWORD": str(word), "PATH": "/usr/bin:/bin"}
    done = subprocess.run(
        ["bash", "--norc", "-c", script + _ASK], env=given, capture_output=True, text=True, check=True
    )
    assert set(done.stdout.splitlines()) == offered
    assert done.stderr == ""


_ZSH = (
    "autoload -Uz compinit bashcompinit; compinit -D; bashcompinit; emulate sh -o kshglob -o noshglob -o braceexpand\n"
)


@pytest.mark.skipif(shutil.which("zsh") is None, reason="there is no zsh")
def test_zsh_is_offered_the_same(script: str, tmp_path: Path) -> None:
    """All lines in one zsh, with the options under which its bashcompinit calls a function; what does not begin as the
    word on the line zsh leaves out itself, and it does not put apart what follows '='."""
    asked = "".join(f"LINE='{line}'; CWORD={len(line.split(' ')) - 1}{_ASK}echo --\n" for line, _, _ in _LINES)
    done = subprocess.run(
        ["zsh", "-f", "-c", _ZSH + script + asked],
        env={"HOME": str(tmp_path), "PATH": "/usr/bin:/bin"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stderr == ""
    for (line, _, offered), answer in zip(_LINES, done.stdout.split("--\n")[:-1], strict=True):
        before, equals, word = line.rpartition(" ")[2].rpartition("=")
        begun = {each for each in answer.split("\n") if each.startswith(before + equals + word)} - {""}
        assert begun == {before + equals + each for each in offered - {""}}, line
