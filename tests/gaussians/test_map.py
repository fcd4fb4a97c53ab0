"""All columns of a map stay in step, whatever happens to its Gaussians: each is marked, and the marks are read back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from bench.gaussians.map import SKY, GaussianMap
from bench.types import Trajectory

AT = {7: 0.0, 3: 10.0, 5: 20.0}
"""Three keyframes, added in this order, and where their cameras stand on the x axis."""


def pose(x: float) -> np.ndarray:
    T = np.eye(4)
    T[0, 3] = x
    return T


def marked(sh_degree: int = 0) -> GaussianMap:
    """Four Gaussians from each of three keyframes; every column of Gaussian i holds i or a multiple of it."""
    made = GaussianMap(sh_degree, torch.device("cpu"))
    for number, x in AT.items():
        marks = torch.arange(len(made), len(made) + 4).float()
        made.add(number, pose(x), marks.repeat(14, 1), 100 * marks)
    made.first_moment += made.planes
    made.second_moment += 2 * made.planes
    return made


def marks_of(gaussians: GaussianMap) -> list[int]:
    """The mark of each Gaussian, which all its columns agree on; those with zero moments aside."""
    marks = gaussians.planes[0]
    assert torch.equal(gaussians.planes[:14], marks.repeat(14, 1))
    assert torch.equal(gaussians.birth_depth, 100 * marks)
    learned = gaussians.first_moment[0] > 0
    assert torch.equal(gaussians.first_moment[:14, learned], marks[learned].repeat(14, 1))
    assert torch.equal(gaussians.second_moment[:14, learned], 2 * marks[learned].repeat(14, 1))
    return [int(mark) for mark in marks]


def followers(gaussians: GaussianMap) -> dict[int, list[int]]:
    """Which Gaussians, by index, move when a keyframe does; it is put back again."""
    found = {}
    for number, x in AT.items():
        before = gaussians.planes[1].clone()
        for y in (1.0, 0.0):
            T = pose(x)
            T[1, 3] = y
            gaussians.follow(Trajectory(T[None], np.array([number]), np.zeros(1)), 0.0, 0.0)
            if y:
                found[number] = torch.nonzero(gaussians.planes[1] != before)[:, 0].tolist()
    return found


def test_added_gaussians_come_last_and_belong_to_their_keyframe() -> None:
    assert marks_of(marked()) == list(range(12))
    assert followers(marked()) == {7: [0, 1, 2, 3], 3: [4, 5, 6, 7], 5: [8, 9, 10, 11]}


@pytest.mark.parametrize("sh_degree", [1, 2, 3])
def test_seeds_have_zero_higher_harmonics(sh_degree: int) -> None:
    planes = marked(sh_degree).planes
    assert planes.shape == (11 + 3 * (sh_degree + 1) ** 2, 12)
    assert not planes[14:].any()


def test_kept_gaussians_keep_their_columns_and_their_keyframe() -> None:
    gaussians = marked()
    gaussians.keep(gaussians.planes[0] % 3 == 0)
    assert marks_of(gaussians) == [0, 3, 6, 9]
    assert followers(gaussians) == {7: [0, 1], 3: [2], 5: [3]}


def test_a_split_gaussian_is_replaced_by_children_of_its_keyframe() -> None:
    """Gaussian 5 splits in two, Gaussian 1 is cloned."""
    gaussians = marked()
    parents = torch.tensor([5, 5, 1])
    gone = torch.zeros(12, dtype=torch.bool)
    gone[5] = True
    gaussians.replace(gone, parents.float().repeat(14, 1), parents)
    assert marks_of(gaussians) == [0, 1, 2, 3, 1, 4, 6, 7, 5, 5, 8, 9, 10, 11]
    new = torch.tensor([4, 8, 9])
    assert not gaussians.first_moment[:, new].any()
    assert not gaussians.second_moment[:, new].any()
    assert followers(gaussians) == {7: [0, 1, 2, 3, 4], 3: [5, 6, 7, 8, 9], 5: [10, 11, 12, 13]}


@pytest.mark.parametrize("which", [slice(2, 9, 3), torch.tensor([2, 5, 8]), torch.arange(12) % 3 == 2])
def test_a_selection_shares_nothing(which: Tensor | slice) -> None:
    gaussians = marked()
    chosen = gaussians.select(which)
    assert marks_of(chosen)[:3] == [2, 5, 8]
    assert followers(chosen)[3] == [1]
    everything = gaussians.select(slice(None))
    everything.planes += 1.0
    everything.first_moment += 1.0
    assert marks_of(gaussians) == list(range(12))


def test_a_restored_map_learns_alike(tmp_path: Path) -> None:
    gaussians = marked()
    gaussians.keep(gaussians.planes[0] != 4)
    torch.save(gaussians.state(), tmp_path / "state.pt")
    again = GaussianMap(0, torch.device("cpu"))
    again.restore(torch.load(tmp_path / "state.pt"))
    assert marks_of(again) == marks_of(gaussians)
    assert followers(again) == followers(gaussians)


def test_a_saved_map_is_opened_again(tmp_path: Path) -> None:
    gaussians = GaussianMap(2, torch.device("cpu"))
    planes = torch.randn(38, 9, generator=torch.Generator().manual_seed(0))
    planes[6:10] = torch.nn.functional.normalize(planes[6:10], dim=0)
    gaussians.add(0, np.eye(4), planes, torch.ones(9))
    gaussians.save(tmp_path / "map.ply")
    loaded = GaussianMap.load(tmp_path / "map.ply")
    assert loaded.sh_degree == 2
    torch.testing.assert_close(loaded.planes, planes, rtol=0, atol=1e-7)
    motion = loaded.follow(Trajectory(pose(3.0)[None], np.array([0]), np.zeros(1)), 0.0, 0.0)
    assert motion.gaussians == 0


def with_sky() -> GaussianMap:
    """As ``marked``, and three Gaussians of the sky that were seen from (5, 0, 0), 200 m ahead."""
    made = marked()
    sky = torch.zeros(14, 3)
    sky[2], sky[3] = 200.0, torch.arange(3.0)
    made.add_sky(np.array([5.0, 0.0, 0.0]), sky, torch.full((3,), 200.0), 1e-3)
    return made


def test_the_sky_comes_first_and_moves_with_who_looks_at_it() -> None:
    made = with_sky()
    assert (made.sky, made.anchor.tolist()) == (3, [SKY] * 3 + [0] * 4 + [1] * 4 + [2] * 4)
    rest = made.planes[:, 3:].clone()
    for place in ([0.0, 0.0, 0.0], [7.0, -2.0, 1000.0]):
        seen = made.seen_from(np.array(place)).clone()
        expected = torch.tensor([place[0] - 5.0, place[1], place[2] + 200.0])
        torch.testing.assert_close(seen[:3, :3], expected[:, None].expand(3, 3))
        assert seen[3, :3].tolist() == [0, 1, 2]
        assert torch.equal(seen[:, 3:], rest)
    for random in np.random.default_rng(0).uniform(-3000, 3000, (100, 3)):
        made.seen_from(random)  # the way here makes no difference
    assert torch.equal(made.seen_from(np.array(place)), seen)
    assert followers(made) == {7: [3, 4, 5, 6], 3: [7, 8, 9, 10], 5: [11, 12, 13, 14]}


def test_the_sky_grows_only_in_directions_where_it_has_nothing_yet() -> None:
    made, place = with_sky(), np.array([-40.0, 3.0, 500.0])
    sky = torch.zeros(14, 4)
    sky[:3] = torch.from_numpy(place)[:, None]
    sky[2] += 200.0
    sky[0] += torch.tensor([-5.0, -4.0, 7.0, -8.0])  # at -1.4 degrees there is some already
    made.add_sky(place, sky, torch.full((4,), 200.0), cell=np.deg2rad(1.0))
    assert made.sky == 5
    assert sorted(made.seen_from(place)[0, :5].tolist()) == [-48, -45, -45, -45, -33]


def test_the_sky_of_a_saved_map_is_known_again(tmp_path: Path) -> None:
    made = with_sky()
    before = made.seen_from(np.array([3.0, 1.0, 0.0])).clone()
    made.save(tmp_path / "map.ply")
    assert GaussianMap.load(tmp_path / "map.ply").sky == 3
    again = GaussianMap(0, "cpu")
    again.restore(made.state())
    assert torch.equal(again.seen_from(np.array([3.0, 1.0, 0.0])), before)
