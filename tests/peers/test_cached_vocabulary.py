"""The vocabulary that is made once for a sequence: where it lies, what it is trained on, when it is made again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.contracts.dataset import Dataset
from bench.errors import BenchError
from bench.peers.cached_vocabulary import dbow2_vocabulary_of
from bench.tracking.loops.training_images import descriptors_of
from bench.types import StereoCamera, StereoFrame


class Noise(Dataset):
    """Frames of noise; remembers which were asked for."""

    def __init__(self, count: int, seed: int = 0) -> None:
        self.label = "noise"
        self.camera = StereoCamera(200, 150, 100.0, 100.0, 99.5, 74.5, (0.5, 0.0, 0.0))
        self.numbers = tuple(range(count))
        self._seed, self.asked = seed, list[int]()

    def frame(self, position: int) -> StereoFrame:
        self.asked.append(position)
        rng = np.random.default_rng([self._seed, position])
        image = np.repeat(rng.integers(0, 256, (150, 200, 1), dtype=np.uint8), 3, axis=2)
        return StereoFrame(position, 0.1 * position, image, image)


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "bgs-bench"


def test_frames_are_spread_over_the_sequence() -> None:
    dataset = Noise(101)
    images = descriptors_of(dataset, frames=5, features=50)
    assert dataset.asked == [0, 25, 50, 75, 100]
    assert all(image.dtype == np.uint64 and image.shape[1] == 4 and 0 < len(image) <= 60 for image in images)
    assert len(descriptors_of(Noise(3), frames=5, features=50)) == 3
    with pytest.raises(BenchError, match="can't be trained from 0 frames; give 1 or more"):
        descriptors_of(dataset, frames=0)


def test_it_is_made_once_for_a_sequence(cache: Path) -> None:
    path = dbow2_vocabulary_of(Noise(4))
    assert path.parent == cache
    assert path.read_text().startswith("10 6 0 0\n")
    assert [file.name for file in cache.iterdir()] == [path.name]
    again = Noise(4)
    assert dbow2_vocabulary_of(again) == path
    assert again.asked == [0]  # only to tell the sequences apart
    assert dbow2_vocabulary_of(Noise(5)) != path
    assert dbow2_vocabulary_of(Noise(4, seed=1)) != path


def test_a_cache_that_can_not_be_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    with pytest.raises(BenchError, match=r"can't be made \(Not a directory\)\. Set \$XDG_CACHE_HOME to a folder that"):
        dbow2_vocabulary_of(Noise(4))
