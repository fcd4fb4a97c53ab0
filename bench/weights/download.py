"""Download of a file over HTTP that resumes where it was cut, and puts the file in place only when it is right."""

from __future__ import annotations

import http.client
import os
import shutil
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import IO, NoReturn

from bench.errors import BenchError
from bench.io.file_lock import exclusive
from bench.weights.checksum import sha256_of

Report = Callable[[int, int | None], None]
"""Called as the file grows: bytes here, bytes in all (None where the server does not say)."""

_CHUNK = 1 << 20
_UNSATISFIABLE = 416


class _CutError(Exception):
    """The connection ended early or could not be made: worth another try."""


def download(
    url: str,
    target: Path,
    sha256: str = "",
    report: Report | None = None,
    tries: int = 5,
    timeout_s: float = 30.0,
    pause_s: float = 1.0,
    *,
    size: int | None = None,
    setting: str = "$BGS_CACHE",
) -> str:
    """Fetch ``url`` to ``target``, whole and verified, or not at all; what came of it stays beside for the next try.

    Returns the SHA-256 of the file, also of one that lay there already and may be another.

    ``sha256`` holds the digits, or the leading ones, that are known, ``size`` the bytes of the file where those are;
    ``setting`` is where a user says that the file should go elsewhere. A connection that is cut is made again up to
    ``tries`` times without a new byte, ``pause_s`` times their number apart, and resumes by an HTTP range. Two
    processes do not fetch the same file at once. Raises ``BenchError``: no connection, refused, no space, another file.
    """
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with exclusive(target.with_name(f".{target.name}.lock")):
            if target.is_file():
                return sha256_of(target)
            part = _Part(target, resumable=bool(sha256), size=size, setting=setting)
            _fetch_with_retries(url, part, report, tries, timeout_s, pause_s)
            if size is not None and part.size != size:
                part.raise_other_size(url, part.size)
            got = sha256_of(part.path)
            if not got.startswith(sha256):
                part.remove()
                raise BenchError(
                    f"{url} gave a file with SHA-256 {got}, which should begin with {sha256}; it was removed. Try "
                    "again, and if that gives the same, look at the page for a changed file."
                )
            os.replace(part.path, target)
            part.remove()
            return got
    except OSError as error:
        raise BenchError(
            f"Can't write {target}: {error.strerror or error}. Check the folder and the free space, or set {setting}."
        ) from error


class _Part:
    """The file as far as it has come, and what the server calls the version that it belongs to."""

    def __init__(self, target: Path, resumable: bool, size: int | None, setting: str) -> None:
        self.path = target.with_name(f".{target.name}.part")
        self._validator = target.with_name(f".{target.name}.version")
        self._resumable = resumable
        self.wanted, self.setting = size, setting
        self.by_browser = f"If a browser gets the file from there, save it as {target} and give the command again."

    @property
    def size(self) -> int:
        return self.path.stat().st_size if self.path.is_file() else 0

    def headers(self) -> dict[str, str]:
        """What to ask for: the rest, if it can be told that it is the rest of the same file; else everything."""
        version = self._validator.read_text() if self._validator.is_file() else ""
        if not self.size or not (version or self._resumable):
            return {}
        return {"Range": f"bytes={self.size}-"} | ({"If-Range": version} if version else {})

    def remember_version(self, answer: http.client.HTTPResponse) -> None:
        tag = answer.headers.get("ETag", "")
        # A weak tag does not promise equal bytes (RFC 9110, 13.1.5).
        version = tag if tag and not tag.startswith("W/") else answer.headers.get("Last-Modified", "")
        self._validator.write_text(version)

    def raise_other_size(self, url: str, size: int) -> NoReturn:
        self.remove()
        raise BenchError(
            f"{url} is a file of {size} bytes, and the published one has {self.wanted}; it was removed. Look at the "
            "page for a changed file."
        )

    def remove(self) -> None:
        self.path.unlink(missing_ok=True)
        self._validator.unlink(missing_ok=True)


def _fetch_with_retries(
    url: str, part: _Part, report: Report | None, tries: int, timeout_s: float, pause_s: float
) -> None:
    failures = 0
    while True:
        before = part.size
        try:
            _fetch_rest(url, part, report, timeout_s)
            return
        except _CutError as cut:
            failures = 1 if part.size > before else failures + 1
            if failures >= tries:
                if not part.size:
                    raise BenchError(f"{url} can't be reached ({cut}). Check the network.") from cut
                raise BenchError(
                    f"The download of {url} stopped after {part.size} bytes ({cut}). Give the command again: it "
                    "resumes from there."
                ) from cut
            time.sleep(pause_s * failures)


def _fetch_rest(url: str, part: _Part, report: Report | None, timeout_s: float) -> None:
    asked = part.headers()
    headers = {"User-Agent": "bgs-bench", "Accept-Encoding": "identity"} | asked
    try:
        answer = urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=timeout_s)
    except urllib.error.HTTPError as error:
        if error.code == _UNSATISFIABLE and asked:
            # There is nothing behind what is here: it is whole, which the checksum tells, or of another file.
            if error.headers.get("Content-Range", "") == f"bytes */{part.size}":
                return
            part.remove()
            raise _CutError("the server has another file now") from error
        if error.code >= 500:
            raise _CutError(f"the server answered {error.code}") from error
        text = f"{url}: the server answered {error.code} {error.reason}. {part.by_browser}"
        raise BenchError(text) from error
    except urllib.error.URLError as error:
        raise _CutError(str(error.reason)) from error
    except (http.client.HTTPException, OSError) as error:
        raise _CutError(str(error) or type(error).__name__) from error
    with answer:
        _receive(answer, part, report)


def _receive(answer: http.client.HTTPResponse, part: _Part, report: Report | None) -> None:
    if answer.headers.get_content_type() == "text/html":
        raise BenchError(f"{answer.url} gave a web page, not a file. {part.by_browser}")
    start = part.size if answer.status == http.HTTPStatus.PARTIAL_CONTENT else 0
    if start and not answer.headers.get("Content-Range", "").startswith(f"bytes {start}-"):
        part.remove()
        raise _CutError("the server sent another range than asked for")
    length = answer.headers.get("Content-Length")
    total = start + int(length) if length else None
    if part.wanted is not None and total is not None and total != part.wanted:
        part.raise_other_size(answer.url, total)
    free = shutil.disk_usage(part.path.parent).free
    if total is not None and total - start > free:
        raise BenchError(
            f"{answer.url} needs {(total - start) / 1e9:.2f} GB, and {part.path.parent} has {free / 1e9:.2f} GB free. "
            f"Make room, or set {part.setting} to a folder that has it."
        )
    if not start:
        part.remember_version(answer)
    with open(part.path, "ab" if start else "wb") as file:
        here = _copy(answer, file, start, total, report)
    if total is not None and here < total:
        raise _CutError(f"the connection was cut at {here} of {total} bytes")


def _copy(answer: IO[bytes], file: IO[bytes], here: int, total: int | None, report: Report | None) -> int:
    """Write what comes as it comes, so that a cut loses nothing; returns the file's size then."""
    while chunk := _read(answer):
        file.write(chunk)
        here += len(chunk)
        if report is not None:
            report(here, total)
    file.flush()
    os.fsync(file.fileno())
    return here


def _read(answer: IO[bytes]) -> bytes:
    try:
        return answer.read(_CHUNK)
    except (http.client.HTTPException, OSError) as error:
        raise _CutError(str(error) or type(error).__name__) from error
