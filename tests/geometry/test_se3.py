"""Rigid motions against torch's matrix exponential, hand-worked rotations and round trips."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from bench.geometry import se3
from bench.types import PinholeView


def tangents(scale: float, count: int = 50) -> np.ndarray:
    return np.random.default_rng(3).normal(size=(count, 6)) * scale


@pytest.mark.parametrize("scale", [0.0, 1e-9, 1e-5, 1e-3, 0.3, 1.0])
def test_exp_equals_the_matrix_exponential(scale: float) -> None:
    xi = tangents(scale)
    generator = np.zeros((len(xi), 4, 4))
    generator[:, :3, :3] = se3.skew(xi[:, 3:])
    generator[:, :3, 3] = xi[:, :3]
    expected = torch.linalg.matrix_exp(torch.from_numpy(generator)).numpy()
    np.testing.assert_allclose(se3.exp(xi), expected, atol=1e-13)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-7, 9e-5, 1.1e-4, 0.1, 1.5, 3.0, np.pi - 1e-7])
def test_log_undoes_exp(angle: float) -> None:
    xi = tangents(1.0)
    xi[:, 3:] *= angle / np.linalg.norm(xi[:, 3:], axis=1, keepdims=True)
    np.testing.assert_allclose(se3.log(se3.exp(xi)), xi, atol=1e-8)


def test_inverse_is_the_matrix_inverse() -> None:
    T = se3.exp(tangents(1.0))
    np.testing.assert_allclose(se3.inverse(T), np.linalg.inv(T), atol=1e-13)


@pytest.mark.parametrize(
    ("rotation", "quaternion"),
    [
        (np.eye(3), (0, 0, 0, 1)),
        ([[0, -1, 0], [1, 0, 0], [0, 0, 1]], (0, 0, 0.5**0.5, 0.5**0.5)),  # 90 degrees about z
        ([[1, 0, 0], [0, -1, 0], [0, 0, -1]], (1, 0, 0, 0)),  # 180 degrees about x: trace -1
        ([[0, 0, 1], [1, 0, 0], [0, 1, 0]], (0.5, 0.5, 0.5, 0.5)),  # x -> y -> z -> x
    ],
)
def test_hand_worked_quaternions(rotation: list[list[float]], quaternion: tuple[float, ...]) -> None:
    np.testing.assert_allclose(se3.rotation_to_quaternion(np.array(rotation, float)), quaternion, atol=1e-15)
    np.testing.assert_allclose(se3.quaternion_to_rotation(np.array(quaternion, float)), rotation, atol=1e-15)


def test_quaternions_round_trip_near_half_a_turn() -> None:
    xi = tangents(1.0)
    xi[:, 3:] *= (np.pi - 1e-9) / np.linalg.norm(xi[:, 3:], axis=1, keepdims=True)
    R = se3.exp(xi)[:, :3, :3]
    np.testing.assert_allclose(se3.quaternion_to_rotation(se3.rotation_to_quaternion(R)), R, atol=1e-14)


def test_products_of_quaternions_are_those_of_scipy() -> None:
    p, q = (np.random.default_rng(seed).normal(size=(20, 4)) for seed in (1, 2))
    product = se3.quaternion_product(p, q)
    turns = Rotation.from_quat(p) * Rotation.from_quat(q)
    np.testing.assert_allclose(se3.quaternion_to_rotation(product), turns.as_matrix(), atol=1e-14)
    lengths = np.linalg.norm(p, axis=1) * np.linalg.norm(q, axis=1)
    np.testing.assert_allclose(np.linalg.norm(product, axis=1), lengths, rtol=1e-14)
    np.testing.assert_array_equal(se3.quaternion_product(p[3], q)[5], se3.quaternion_product(p[3], q[5]))


@pytest.mark.parametrize("angle", [0.0, 1e-3, 0.5, 3.0])
def test_a_quaternion_by_way_of_the_rotation_vector_is_that_of_scipy(angle: float) -> None:
    turn = Rotation.from_rotvec(angle * np.array([0.48, -0.6, 0.64]))
    np.testing.assert_allclose(se3.rotation_to_quaternion_by_vector(turn.as_matrix()), turn.as_quat(), atol=1e-12)


def test_orthonormalise_gives_the_nearest_rotation() -> None:
    T = se3.exp(tangents(1.0))
    stretched = T.copy()
    stretched[:, :3, :3] *= 1.01
    np.testing.assert_allclose(se3.orthonormalise(stretched), T, atol=1e-13)
    mirrored = np.eye(4)
    mirrored[2, 2] = -0.1
    assert np.linalg.det(se3.orthonormalise(mirrored)[:3, :3]) == pytest.approx(1.0)


def test_rotation_angle_keeps_digits_of_small_angles() -> None:
    assert se3.rotation_angle(se3.so3_exp(np.array([0.0, 3e-9, 4e-9]))) == pytest.approx(5e-9, rel=1e-6)


def test_a_view_is_inverted_once() -> None:
    T = se3.exp(tangents(1.0, 1)[0])
    view = PinholeView(T, 50.0, 55.0, 18.0, 13.0, 40, 24)
    np.testing.assert_allclose(view.T_cam_world @ T, np.eye(4), atol=1e-14)
    assert view.halved().T_cam_world is view.T_cam_world
    assert replace(view, T_world_cam=np.eye(4)).T_cam_world[0, 3] == 0
