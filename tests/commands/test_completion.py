"""``bgs-bench completion``: its script, asked by bash itself."""

from __future__ import annotations

import subprocess

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


@pytest.mark.parametrize(
    ("line", "word", "offered"),
    [
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
    ],
)
def test_bash_is_offered(line: str, word: int, offered: set[str], script: str) -> None:
    given = {"LINE": line, "CWORD": str(word), "PATH": "/usr/bin:/bin"}
    done = subprocess.run(
        ["bash", "--norc", "-c", script + _ASK], env=given, capture_output=True, text=True, check=True
    )
    assert set(done.stdout.splitlines()) == offered
    assert done.stderr == ""
