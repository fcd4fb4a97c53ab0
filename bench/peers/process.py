"""A child process that answers messages, and every way in which it can fail to."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import tempfile
import time
import weakref
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO

import bench
from bench.peers.messages import MalformedMessageError, Message, encode, read_message
from bench.process_memory import note_peak

# A child that has closed its output is about to end; this long is waited for the code that says why.
_EXIT_GRACE_S = 2.0
_LOG_TAIL_BYTES = 2000


class PeerFailure(Exception):  # noqa: N818 - it is no error of the program's
    """The peer crashed, hung or answered nonsense; the text says which. It has been killed."""


class PeerProcess:
    """One running peer. It has a session of its own, so that Ctrl-C does not reach it, and an empty working folder,
    which goes with it. It is killed when this object is closed, collected, or when Python ends; a peer that
    ``bench.peers.serve`` runs also ends by itself when the bench is killed."""

    def __init__(self, command: Sequence[str]) -> None:
        """Start ``command``; it reads messages from its standard input and answers on its standard output.

        Raises ``PeerFailure`` when it can't be started.
        """
        self._scratch = tempfile.TemporaryDirectory(prefix="bgs-peer-")
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 - closed with the process
        root = str(Path(bench.__file__).parents[1])
        path = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])
        try:
            self._process = subprocess.Popen(
                list(command),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._log,
                bufsize=0,
                cwd=self._scratch.name,
                env=os.environ | {"PYTHONPATH": path},
                start_new_session=True,
            )
        except OSError as error:
            self._log.close()
            self._scratch.cleanup()
            raise PeerFailure(f"could not be started ({error})") from error
        self._end = weakref.finalize(self, _end, self._process, self._log, self._scratch)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._to, self._from = self._process.stdin.fileno(), self._process.stdout.fileno()
        for descriptor in (self._to, self._from):
            os.set_blocking(descriptor, False)

    @property
    def pid(self) -> int:
        """Process id of the child, for logs and tests."""
        return self._process.pid

    def request(self, message: Message, timeout_s: float) -> Message:
        """Send a message and wait for the answer; raises ``PeerFailure``, and kills the child, if there is none."""
        if not self._end.alive:
            raise PeerFailure("is not running")
        deadline = time.monotonic() + timeout_s
        try:
            for piece in encode(message):
                self._write(piece, deadline)
            answer = read_message(lambda size: self._read(size, deadline))
            note_peak(self.pid)
            return answer
        except MalformedMessageError as error:
            self.close()
            raise PeerFailure(f"wrote something that is no answer: {error}") from error
        except TimeoutError:
            self.close()
            raise PeerFailure(f"gave no answer within {timeout_s:g} s and was killed") from None
        except (EOFError, BrokenPipeError):
            raise PeerFailure(self._how_it_ended()) from None
        except BaseException:
            # An answer that is not awaited (Ctrl-C) would be taken for that to the next request.
            self.close()
            raise

    def close(self) -> None:
        """Kill the child and everything that it started; nothing of it is left. Can be called again."""
        self._end()

    def _write(self, piece: bytes | memoryview, deadline: float) -> None:
        left = memoryview(piece)
        while left:
            _wait_for(self._to, select.POLLOUT, deadline)
            with suppress(BlockingIOError):
                left = left[os.write(self._to, left) :]

    def _read(self, size: int, deadline: float) -> bytearray:
        buffer = bytearray(size)
        view, got = memoryview(buffer), 0
        while got < size:
            _wait_for(self._from, select.POLLIN, deadline)
            with suppress(BlockingIOError):
                count = os.readv(self._from, [view[got:]])
                if count == 0:
                    raise EOFError
                got += count
        return buffer

    def _how_it_ended(self) -> str:
        try:
            code = self._process.wait(_EXIT_GRACE_S)
        except subprocess.TimeoutExpired:
            code = None
        last = _last_line(self._log)
        self.close()
        if code is None:
            how = "closed its output"
        elif code < 0:
            how = f"was killed by {_signal_name(-code)}"
        else:
            how = f"ended with exit code {code}"
        return f"{how}; its last words: {last}" if last else how


def _wait_for(descriptor: int, event: int, deadline: float) -> None:
    poll = select.poll()
    poll.register(descriptor, event)
    if not poll.poll(max(0.0, deadline - time.monotonic()) * 1e3):
        raise TimeoutError


def _end(process: subprocess.Popen[bytes], log: IO[bytes], scratch: tempfile.TemporaryDirectory[str]) -> None:
    if process.returncode is None:
        # The child leads its process group, which lives as long as it has not been waited for.
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    for stream in (process.stdin, process.stdout, log):
        assert stream is not None
        stream.close()
    scratch.cleanup()


def _last_line(log: IO[bytes]) -> str:
    log.seek(0, os.SEEK_END)
    log.seek(max(0, log.tell() - _LOG_TAIL_BYTES))
    lines = log.read().decode(errors="replace").strip().splitlines()
    return lines[-1].strip()[:200] if lines else ""


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
