"""Downloads against a server of our own that misbehaves; nothing leaves this machine."""

from __future__ import annotations

import hashlib
import re
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from cutting_server import CuttingServer, serving

from bench.errors import BenchError
from bench.weights.download import download

CONTENT = np.random.default_rng(0).bytes(300_000)
SHA256 = hashlib.sha256(CONTENT).hexdigest()


@pytest.fixture
def server() -> Iterator[CuttingServer]:
    with serving(CONTENT) as running:
        yield running


def test_a_cut_download_is_resumed_where_it_was(server: CuttingServer, tmp_path: Path) -> None:
    server.cuts = [100_000, 50_000]
    told: list[tuple[int, int | None]] = []
    download(server.url, tmp_path / "a" / "net.pth", SHA256, lambda *now: told.append(now), pause_s=0)
    assert (tmp_path / "a" / "net.pth").read_bytes() == CONTENT
    assert server.asked == [None, "bytes=100000-", "bytes=150000-"]
    assert told[-1] == (300_000, 300_000)
    assert [file.name for file in (tmp_path / "a").iterdir() if not file.name.endswith(".lock")] == ["net.pth"]


def test_the_next_command_resumes_it_too(server: CuttingServer, tmp_path: Path) -> None:
    target = tmp_path / "net.pth"
    server.cuts = [70_000]
    with pytest.raises(BenchError, match=r"stopped after 70000 bytes .*Give the command again: it resumes from there"):
        download(server.url, target, SHA256, tries=1)
    assert not target.exists()
    download(server.url, target, SHA256, tries=1)
    assert server.asked == [None, "bytes=70000-"]
    assert target.read_bytes() == CONTENT


def test_each_new_byte_earns_new_tries(server: CuttingServer, tmp_path: Path) -> None:
    server.cuts = [50_000] * 5
    download(server.url, tmp_path / "net.pth", SHA256, tries=2, pause_s=0)
    assert (tmp_path / "net.pth").read_bytes() == CONTENT


def test_a_file_that_changed_meanwhile_is_not_glued_together(server: CuttingServer, tmp_path: Path) -> None:
    server.cuts = [100_000]
    with pytest.raises(BenchError, match="stopped after"):
        download(server.url, tmp_path / "net.pth", tries=1)
    other = np.random.default_rng(1).bytes(200_000)
    server.content, server.etag = other, '"two"'
    download(server.url, tmp_path / "net.pth", tries=1)
    assert (tmp_path / "net.pth").read_bytes() == other


@pytest.mark.parametrize("etag", [None, 'W/"weak"'])
def test_without_checksum_and_version_it_starts_again(server: CuttingServer, tmp_path: Path, etag: str | None) -> None:
    server.cuts, server.etag = [100_000], etag
    download(server.url, tmp_path / "net.pth", pause_s=0)
    assert server.asked == [None, None]
    assert (tmp_path / "net.pth").read_bytes() == CONTENT


def test_a_server_without_ranges_sends_it_all_again(server: CuttingServer, tmp_path: Path) -> None:
    server.cuts, server.ranges_allowed = [100_000], False
    download(server.url, tmp_path / "net.pth", SHA256, pause_s=0)
    assert (tmp_path / "net.pth").read_bytes() == CONTENT


def test_a_part_that_is_whole_already_is_taken(server: CuttingServer, tmp_path: Path) -> None:
    """As after a kill between the last byte and the renaming: the server has no more bytes to give (416)."""
    (tmp_path / ".net.pth.part").write_bytes(CONTENT)
    download(server.url, tmp_path / "net.pth", SHA256, tries=1)
    assert (tmp_path / "net.pth").read_bytes() == CONTENT


def test_a_part_longer_than_the_file_is_thrown_away(server: CuttingServer, tmp_path: Path) -> None:
    (tmp_path / ".net.pth.part").write_bytes(CONTENT + b"more")
    download(server.url, tmp_path / "net.pth", SHA256, pause_s=0)
    assert (tmp_path / "net.pth").read_bytes() == CONTENT


def test_the_wrong_file_is_removed(server: CuttingServer, tmp_path: Path) -> None:
    with pytest.raises(BenchError, match=rf"gave a file with SHA-256 {SHA256}, which should begin with 0123; it was"):
        download(server.url, tmp_path / "net.pth", "0123")
    assert [file.name for file in tmp_path.iterdir()] == [".net.pth.lock"]
    # What was half there of another file is no lasting harm either: the next command starts anew.
    (tmp_path / ".net.pth.part").write_bytes(b"x" * 1000)
    with pytest.raises(BenchError, match="it was removed"):
        download(server.url, tmp_path / "net.pth", SHA256)
    download(server.url, tmp_path / "net.pth", SHA256[:8])
    assert (tmp_path / "net.pth").read_bytes() == CONTENT


def test_a_web_page_is_no_file(server: CuttingServer, tmp_path: Path) -> None:
    server.content_type = "text/html; charset=utf-8"
    with pytest.raises(BenchError, match="gave a web page, not a file"):
        download(server.url, tmp_path / "net.pth")
    assert not (tmp_path / "net.pth").exists()


def test_what_the_server_refuses_is_said_at_once(server: CuttingServer, tmp_path: Path) -> None:
    server.status = 404
    with pytest.raises(BenchError, match=r"net\.pth: the server answered 404 Not Found"):
        download(server.url, tmp_path / "net.pth")
    assert len(server.asked) == 1
    server.status = 503
    with pytest.raises(BenchError, match=r"can't be reached \(the server answered 503\)"):
        download(server.url, tmp_path / "net.pth", tries=3, pause_s=0)
    assert len(server.asked) == 4


def test_a_server_that_is_not_there(tmp_path: Path) -> None:
    with serving(b"") as server:
        gone = server.url
    with pytest.raises(BenchError, match=re.escape(f"{gone} can't be reached") + ".*Check the network"):
        download(gone, tmp_path / "net.pth", tries=2, pause_s=0)


def test_no_space(server: CuttingServer, tmp_path: Path) -> None:
    server.claimed_length = shutil.disk_usage(tmp_path).total * 2
    with pytest.raises(BenchError, match=r"needs [\d.]+ GB, and .* has [\d.]+ GB free"):
        download(server.url, tmp_path / "net.pth")


def test_a_folder_that_can_not_be_made(server: CuttingServer, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(BenchError, match=r"Can't write .*net\.pth: .*BGS_CACHE"):
        download(server.url, tmp_path / "file" / "net.pth")


def test_two_at_once_fetch_it_once(server: CuttingServer, tmp_path: Path) -> None:
    target = tmp_path / "net.pth"
    threads = [threading.Thread(target=download, args=(server.url, target, SHA256)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(server.asked) == 1
    assert target.read_bytes() == CONTENT
