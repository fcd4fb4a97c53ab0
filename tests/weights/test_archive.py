"""One member out of an archive, and archives that try to write elsewhere; built here with tarfile and zipfile."""

from __future__ import annotations

import io
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from bench.errors import BenchError
from bench.weights.archive import extract_member

MEMBER = "pkg/net.tar"


def tar_of(path: Path, *names: str, link_to: str = "", kind: bytes = tarfile.REGTYPE) -> Path:
    with tarfile.open(path, "w:gz") as tar:
        for name in names:
            info = tarfile.TarInfo(name)
            info.type, info.linkname, info.size = kind, link_to, 7 if kind == tarfile.REGTYPE else 0
            tar.addfile(info, io.BytesIO(b"weights"))
    return path


def zip_of(path: Path, *names: str, mode: int = 0o100644) -> Path:
    with zipfile.ZipFile(path, "w") as bundle:
        for name in names:
            info = zipfile.ZipInfo(name)
            info.external_attr = mode << 16
            bundle.writestr(info, b"weights")
    return path


@pytest.mark.parametrize("make", [tar_of, zip_of])
@pytest.mark.parametrize("name", [MEMBER, f"Pkg-1.0/{MEMBER}"])
def test_the_one_member(tmp_path: Path, make: Callable[..., Path], name: str) -> None:
    archive = make(tmp_path / "a.bin", "setup.py", "other/pkg/sub/net.tar", name)
    extract_member(archive, MEMBER, tmp_path / "out")
    assert (tmp_path / "out").read_bytes() == b"weights"
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.bin", "out"]


@pytest.mark.parametrize("make", [tar_of, zip_of])
@pytest.mark.parametrize("name", [f"../{MEMBER}", f"/{MEMBER}"])
def test_a_member_that_leads_out(tmp_path: Path, make: Callable[..., Path], name: str) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    archive = make(inner / "a.bin", name)
    with pytest.raises(BenchError, match="which leads out of its folder; nothing was extracted"):
        extract_member(archive, MEMBER, inner / "out")
    assert [file.name for file in tmp_path.rglob("*") if file.is_file()] == ["a.bin"]


@pytest.mark.parametrize("kind", [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.DIRTYPE, tarfile.FIFOTYPE])
def test_a_link_or_a_folder_is_no_member(tmp_path: Path, kind: bytes) -> None:
    (tmp_path / "secret").write_text("secret")
    archive = tar_of(tmp_path / "a.tar.gz", MEMBER, link_to=str(tmp_path / "secret"), kind=kind)
    with pytest.raises(BenchError, match="is a link or no file; nothing was extracted"):
        extract_member(archive, MEMBER, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_link_in_a_zip(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="is a link or no file"):
        extract_member(zip_of(tmp_path / "a.whl", MEMBER, mode=0o120777), MEMBER, tmp_path / "out")


def test_an_archive_without_it_and_a_damaged_one(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match=r"a\.tar\.gz holds no pkg/net\.tar: it is not the expected package"):
        extract_member(tar_of(tmp_path / "a.tar.gz", "pkg/other"), MEMBER, tmp_path / "out")
    cut = tmp_path / "cut.tar.gz"
    cut.write_bytes((tmp_path / "a.tar.gz").read_bytes()[:40])
    with pytest.raises(BenchError, match=r"cut\.tar\.gz is damaged"):
        extract_member(cut, MEMBER, tmp_path / "out")
    (tmp_path / "no.tar.gz").write_text("no archive")
    with pytest.raises(BenchError, match=r"no\.tar\.gz is damaged"):
        extract_member(tmp_path / "no.tar.gz", MEMBER, tmp_path / "out")
