"""Output that a terminal can't show, or that nobody takes: one line, the right exit code."""

from __future__ import annotations

import errno
import io
import os
import sys

import pytest

from bench import cli
from bench.errors import BenchError
from bench.terminal import print_anywhere


def stream(file: io.BufferedIOBase, encoding: str, at_once: bool = False) -> io.TextIOWrapper:
    return io.TextIOWrapper(file, encoding=encoding, errors="strict", write_through=at_once)


@pytest.mark.parametrize(
    ("encoding", "shown"),
    [
        ("utf-8", "1 ± 2 → Weiß, Видео ✓"),
        ("latin-1", "1 ± 2 -> Weiß, ????? +"),
        ("ascii", "1 +- 2 -> Wei?, ????? +"),
    ],
)
def test_letters_that_a_terminal_lacks_are_replaced(encoding: str, shown: str, monkeypatch: pytest.MonkeyPatch) -> None:
    out = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", stream(out, encoding))
    print_anywhere()
    print("1 ± 2 → Weiß, Видео ✓", flush=True)
    assert out.getvalue().decode(encoding) == shown + "\n"


def test_accents_go_before_letters_do(monkeypatch: pytest.MonkeyPatch) -> None:
    out = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", stream(out, "ascii"))
    print_anywhere()
    print("Müller/été/\udcff", flush=True)
    assert out.getvalue() == b"Muller/ete/?\n"


@pytest.mark.parametrize("arguments", [["list"], ["--help"], ["list", "stereo", "sgbm"]], ids=" ".join)
@pytest.mark.parametrize("at_once", [False, True])
def test_a_full_device_is_one_line(
    arguments: list[str], at_once: bool, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    with open("/dev/full", "wb", buffering=0 if at_once else -1) as full:  # as with PYTHONUNBUFFERED
        monkeypatch.setattr(sys, "stdout", stream(full, "utf-8", at_once))
        assert cli.main(arguments) == 1
        sys.stdout.flush()  # what the interpreter does at its end
    said = capfd.readouterr().err
    assert said == (
        f"bgs-bench: Can't write to standard output: {os.strerror(errno.ENOSPC)}. What was printed is not complete.\n"
    )


@pytest.mark.parametrize("arguments", [["list"], ["--help"]], ids=" ".join)
@pytest.mark.parametrize("at_once", [False, True])
def test_a_reader_that_has_left_is_no_error(
    arguments: list[str], at_once: bool, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "wb", buffering=0 if at_once else -1) as pipe:
        monkeypatch.setattr(sys, "stdout", stream(pipe, "utf-8", at_once))
        assert cli.main(arguments) == 141
        sys.stdout.flush()
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (SystemExit(0), 1, "a plugin ended the program (SystemExit: 0)"),
        (PermissionError(errno.EACCES, "Permission denied", "/closed/x"), 1, "/closed/x: Permission denied."),
        (BenchError("wrong"), 2, "wrong"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
    ids=lambda each: type(each).__name__ if isinstance(each, BaseException) else "",
)
def test_what_a_command_ends_with(
    error: BaseException, code: int, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from bench.commands import doctor

    def failing(args: object) -> int:
        raise error

    monkeypatch.setattr(doctor, "run", failing)
    assert cli.main(["doctor"]) == code
    assert capsys.readouterr().err.startswith(f"bgs-bench: {said}")
