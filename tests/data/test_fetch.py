"""``data get`` against a server on loopback that breaks off, lies about lengths and serves other files."""

from __future__ import annotations

import hashlib
import io
import json
import shutil
import tarfile
import zipfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import pytest

from bench.data.fetch import FetchOptions, fetch, is_here, read_record, read_sums
from bench.data.manifest import Archive, DataSet, entry
from bench.errors import BenchError
from tests.weights.cutting_server import CuttingServer, serving

KITTI = entry("kitti")
COLOR = next(archive for archive in KITTI.archives if archive.part == "color")
CALIB = next(archive for archive in KITTI.archives if "calib" in archive.file)


def archive_of(files: dict[str, bytes], top: str = "dataset/") -> bytes:
    """A zip file as KITTI's are."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as bundle:
        for name, content in files.items():
            bundle.writestr(f"{top}{name}", content)
    return file.getvalue()


def zipped(*names: str, content: bytes = b"") -> bytes:
    """Members hold their own name, or ``content``."""
    return archive_of({name: content or name.encode() for name in names})


def tar_that_claims(name: str, size: int) -> bytes:
    """A tar file with one header."""
    info = tarfile.TarInfo(name)
    info.size = size
    return info.tobuf()


IMAGES = [f"sequences/{sequence}/image_{side}/000000.png" for sequence in ("05", "06") for side in (2, 3)]
GOOD = zipped(*IMAGES, "sequences/06/calib.txt", "sequences/06/times.txt", "readme.txt")
SHA256 = hashlib.sha256(GOOD).hexdigest()


@pytest.fixture
def server() -> Iterator[CuttingServer]:
    with serving(GOOD) as running:
        yield running


def options(server: CuttingServer, sha256: str = "", tries: int = 1, keep: bool = False) -> FetchOptions:
    mirror = server.url.rpartition("/")[0]
    return FetchOptions(mirror, {COLOR.file: sha256} if sha256 else {}, keep, tries, pause_s=0)


def left_in(root: Path) -> list[str]:
    """All files but empty locks."""
    files = [file for file in root.rglob("*") if file.is_file() and not file.name.endswith(".lock")]
    return sorted(str(file.relative_to(root)) for file in files)


def test_the_sequence_asked_for_and_nothing_else(server: CuttingServer, tmp_path: Path) -> None:
    told: list[str] = []
    fetch(tmp_path, KITTI, COLOR, ["06"], options(server), say=told.append)
    # The colour archive's calib.txt lacks the LiDAR's Tr: it must not replace that of the calibration's archive.
    assert left_in(tmp_path) == ["fetched.json", *(f"kitti_odometry/{name}" for name in IMAGES[2:])]
    assert (tmp_path / "kitti_odometry" / IMAGES[2]).read_bytes() == IMAGES[2].encode()
    assert told[0].startswith(f"{SHA256}  {COLOR.file}   (not verified: its publisher tells no sum; recorded, ")
    assert is_here(tmp_path, KITTI, COLOR, ["06"])
    assert not is_here(tmp_path, KITTI, COLOR, ["05"])
    assert not is_here(tmp_path, KITTI, COLOR, [])
    record = json.loads((tmp_path / "fetched.json").read_text())
    assert record[f"kitti/{COLOR.file}"]["sha256"] == SHA256
    assert record[f"kitti/{COLOR.file}"]["size"] == len(GOOD)
    fetch(tmp_path, KITTI, COLOR, ["05"], options(server), say=told.append)
    assert is_here(tmp_path, KITTI, COLOR, ["05", "06"])
    assert len(left_in(tmp_path)) == 5
    (tmp_path / "kitti_odometry" / IMAGES[1]).unlink()
    assert not is_here(tmp_path, KITTI, COLOR, ["05"])  # the file that came last is gone


def test_all_of_it(server: CuttingServer, tmp_path: Path) -> None:
    fetch(tmp_path, KITTI, COLOR, [], options(server, keep=True))
    assert is_here(tmp_path, KITTI, COLOR, ["05"])
    assert is_here(tmp_path, KITTI, COLOR, [])
    kept = f".downloads/kitti/{COLOR.file}"
    assert left_in(tmp_path) == [kept, "fetched.json", *(f"kitti_odometry/{name}" for name in IMAGES)]
    # What was kept is unpacked again without a download.
    shutil.rmtree(tmp_path / "kitti_odometry")
    fetch(tmp_path, KITTI, COLOR, ["06"], options(server))
    assert len(server.asked) == 1
    assert left_in(tmp_path) == ["fetched.json", *(f"kitti_odometry/{name}" for name in IMAGES[2:])]


@pytest.mark.parametrize("etag", ['"one"', None])
def test_killed_in_the_middle_it_goes_on(server: CuttingServer, tmp_path: Path, etag: str | None) -> None:
    """No code of ours runs behind the last byte that came, as after a kill."""
    server.etag, server.cuts = etag, [100]

    class Killed(BaseException):
        pass

    def kill(here: int, total: int | None) -> None:
        raise Killed

    with pytest.raises(Killed):
        fetch(tmp_path, KITTI, COLOR, ["06"], options(server, SHA256), kill)
    assert left_in(tmp_path)[0].rpartition("/")[2] == f".{COLOR.file}.part"
    fetch(tmp_path, KITTI, COLOR, ["06"], options(server, SHA256))
    assert server.asked == [None, "bytes=100-"]
    assert is_here(tmp_path, KITTI, COLOR, ["06"])


@pytest.mark.parametrize("claimed", [len(GOOD) // 2, len(GOOD) - 1])
def test_a_server_that_promises_too_few_bytes(server: CuttingServer, tmp_path: Path, claimed: int) -> None:
    """HTTP ends there, so the archive is cut: found by its sum where that is known, else by its end."""
    server.claimed_length = claimed
    for sha256, message in ((SHA256, f"which should begin with {SHA256}"), ("", "is damaged")):
        with pytest.raises(BenchError, match=message):
            fetch(tmp_path, KITTI, COLOR, ["06"], options(server, sha256))
        assert left_in(tmp_path) == []


def test_a_server_that_promises_too_many_bytes(server: CuttingServer, tmp_path: Path) -> None:
    server.claimed_length = len(GOOD) + 100
    with pytest.raises(BenchError, match=rf"stopped after {len(GOOD)} bytes .*Give the command again"):
        fetch(tmp_path, KITTI, COLOR, ["06"], options(server))
    server.claimed_length = None
    fetch(tmp_path, KITTI, COLOR, ["06"], options(server))
    assert is_here(tmp_path, KITTI, COLOR, ["06"])


@pytest.mark.parametrize("known_size", [len(GOOD) + 1, len(GOOD) - 1])
def test_a_published_size_is_held_against_it(server: CuttingServer, tmp_path: Path, known_size: int) -> None:
    archive = Archive("a.zip", "http://127.0.0.1:9/a.zip", "sequences", size=known_size)
    data = DataSet("made_up", "", "kitti", "made_up", "", "", (archive,))
    with pytest.raises(BenchError, match=f"is a file of {len(GOOD)} bytes, and the published one has {known_size}"):
        fetch(tmp_path, data, archive, [], options(server))
    assert left_in(tmp_path) == []


@pytest.mark.parametrize(
    ("served", "message"),
    [
        (zipped("models/net.onnx"), r"holds nothing that belongs to kitti: it is not the expected file"),
        (b"not an archive", r"is damaged"),
        (zipped("sequences/06/../../../../x"), r"leads out of its folder"),
        (tar_that_claims("sequences/06/image_2/0.png", 10**12), r"far more than its size lets expect"),
    ],
)  # fmt: skip
def test_another_file_leaves_nothing(server: CuttingServer, tmp_path: Path, served: bytes, message: str) -> None:
    server.content = served
    with pytest.raises(BenchError, match=message):
        fetch(tmp_path, KITTI, COLOR, ["06"], options(server))
    assert left_in(tmp_path) == []


def test_a_wrong_sum_is_refused(server: CuttingServer, tmp_path: Path) -> None:
    wrong = "0" * 64
    with pytest.raises(BenchError, match=rf"SHA-256 {SHA256}, which should begin with {wrong}.* that of --sums"):
        fetch(tmp_path, KITTI, COLOR, ["06"], options(server, wrong))
    assert left_in(tmp_path) == []
    # Also where the archive was kept by an earlier command.
    fetch(tmp_path, KITTI, COLOR, ["06"], options(server, keep=True))
    with pytest.raises(BenchError, match=rf"had SHA-256 {SHA256} instead of {wrong} and was removed"):
        fetch(tmp_path, KITTI, COLOR, ["05"], options(server, wrong))
    assert left_in(tmp_path) == ["fetched.json", *(f"kitti_odometry/{name}" for name in IMAGES[2:])]


def test_the_sum_of_the_file_that_came_first_holds(server: CuttingServer, tmp_path: Path) -> None:
    fetch(tmp_path, KITTI, COLOR, ["06"], options(server))
    server.content, server.etag = zipped(*IMAGES, content=b"changed"), '"two"'
    with pytest.raises(BenchError, match=r"should begin with .*that of the file which came first, as .*fetched\.json"):
        fetch(tmp_path, KITTI, COLOR, ["05"], options(server))
    assert left_in(tmp_path) == ["fetched.json", *(f"kitti_odometry/{name}" for name in IMAGES[2:])]
    (tmp_path / "fetched.json").write_text('{"kitti/a": 3}')
    with pytest.raises(BenchError, match=r"fetched\.json is damaged: .*Remove it"):
        read_record(tmp_path)


def test_no_room_to_unpack_keeps_what_was_downloaded(
    server: CuttingServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Usage(NamedTuple):
        free: int

    free = len(GOOD)
    server.content = zipped(*IMAGES, content=bytes(len(GOOD)))[: 10**6]
    fetch(tmp_path, KITTI, CALIB, [], options(server, keep=True))
    shutil.rmtree(tmp_path / "kitti_odometry")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(free))
    with pytest.raises(BenchError, match="needs more space than is free"):
        fetch(tmp_path, KITTI, CALIB, [], options(server))
    assert left_in(tmp_path) == [f".downloads/kitti/{CALIB.file}", "fetched.json"]


def test_archives_in_an_archive(server: CuttingServer, tmp_path: Path) -> None:
    """EuRoC: a zip file and a ROS bag of each sequence in one zip file of the room."""
    euroc = entry("euroc")
    hall = replace(next(each for each in euroc.archives if each.file == "machine_hall.zip"), size=None)
    names = ["mav0/cam0/data.csv", "mav0/cam0/data/1.png", "__MACOSX/._mav0"]
    inner = archive_of(dict.fromkeys(names, b"content"), top="")
    sequences = {f"{name}/{name}{end}": inner for name in ("MH_01_easy", "MH_02_easy") for end in (".zip", ".bag")}
    server.content = archive_of(sequences)
    fetch(tmp_path, euroc, hall, ["MH_01_easy"], options(server))
    camera = "euroc/MH_01_easy/mav0/cam0"
    assert left_in(tmp_path) == [f"{camera}/data.csv", f"{camera}/data/1.png", "fetched.json"]
    assert is_here(tmp_path, euroc, hall, ["MH_01_easy"])
    server.content, server.etag = archive_of({name: inner[:-30] for name in sequences}), '"two"'
    (tmp_path / "fetched.json").unlink()
    with pytest.raises(BenchError, match=r"MH_02_easy\.zip is damaged"):
        fetch(tmp_path, euroc, hall, ["MH_02_easy"], options(server))
    assert len(left_in(tmp_path)) == 2


def test_a_page_instead_of_the_file_says_where_a_browser_may_put_it(server: CuttingServer, tmp_path: Path) -> None:
    server.content_type = "text/html"
    place = tmp_path / ".downloads" / "kitti" / COLOR.file
    with pytest.raises(BenchError, match=rf"gave a web page, not a file\..* save it as {place} and give"):
        fetch(tmp_path, KITTI, COLOR, ["06"], options(server))
    place.write_bytes(GOOD)
    fetch(tmp_path, KITTI, COLOR, ["06"], options(server))
    assert is_here(tmp_path, KITTI, COLOR, ["06"])


def test_two_processes_fetch_it_once(server: CuttingServer, tmp_path: Path) -> None:
    with ThreadPoolExecutor(2) as pool:
        both = [pool.submit(fetch, tmp_path, KITTI, COLOR, ["06"], options(server)) for _ in range(2)]
        for one in both:
            one.result()
    assert len(server.asked) == 1
    assert is_here(tmp_path, KITTI, COLOR, ["06"])


def test_a_folder_that_can_not_be_written(server: CuttingServer, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(BenchError, match=r"Can't write below .*file: Not a directory\. Make room, or set \$BGS_DATA"):
        fetch(tmp_path / "file", KITTI, COLOR, ["06"], options(server))


def test_sums_as_sha256sum_writes_them(tmp_path: Path) -> None:
    path = tmp_path / "SHA256SUMS"
    path.write_text(f"# of the mirror\n{SHA256}  ./a.zip\n\n{SHA256.upper()} *b.zip\n")
    assert read_sums(path) == {"a.zip": SHA256, "b.zip": SHA256}
    path.write_text("d41d8cd98f00b204e9800998ecf8427e  a.zip\n")
    with pytest.raises(BenchError, match=r"'d41d8cd98f00b204e9800998ecf8427e  a\.zip' is no line as sha256sum writes"):
        read_sums(path)
    with pytest.raises(BenchError, match=r"no\.txt can't be read"):
        read_sums(tmp_path / "no.txt")


def test_a_mirror_that_is_no_address(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match=r"The mirror file:///etc is no address"):
        fetch(tmp_path, KITTI, COLOR, [], FetchOptions("file:///etc"))
