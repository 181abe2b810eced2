from typing import get_args

import jax
import numpy as np
import pytest
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

from qjrl.robot.pose_coding import PoseCoding, decode, encode

CODINGS = get_args(PoseCoding)
encode_rows = jax.jit(jax.vmap(encode, (None, 0, 0)), static_argnums=0)
decode_rows = jax.jit(jax.vmap(decode, (None, 0, 0)), static_argnums=0)


def frames(count, seed):
    rng = np.random.default_rng(seed)
    found = np.tile(np.eye(4), (count, 1, 1))
    found[:, :3, :3] = Rotation.random(count, rng).as_matrix()
    found[:, :3, 3] = rng.normal(size=(count, 3))
    return found


def moved(nominal, size, seed):
    """Frames beside the nominal ones, a turn of `size` [rad] and more away."""
    turns = np.random.default_rng(seed).normal(size=(len(nominal), 6))
    turns *= size / np.linalg.norm(turns[:, 3:], axis=1, keepdims=True)
    return np.array([frame @ expm(matrix_of(turn)) for frame, turn in zip(nominal, turns, strict=True)])


def matrix_of(twist):
    matrix = np.zeros((4, 4))
    matrix[:3, :3], matrix[:3, 3] = np.cross(np.eye(3), twist[3:]), twist[:3]
    return matrix


def poses(frames):
    return np.concatenate([frames[:, :3, 3], frames[:, :3, 0], frames[:, :3, 1]], axis=1)


@pytest.mark.parametrize("coding", CODINGS)
@pytest.mark.parametrize("size", [1e-6, 0.1, 3.0])
def test_a_pose_comes_back_from_its_code(coding, size):
    nominal = frames(6, 0)
    actual = moved(nominal, size, 1)
    code = encode_rows(coding, poses(nominal), poses(actual))
    np.testing.assert_allclose(decode_rows(coding, poses(nominal), code), poses(actual), atol=1e-12)
    np.testing.assert_allclose(decode_rows(coding, poses(nominal), 0.0 * code), poses(nominal), atol=1e-14)


def test_the_codes_are_those_of_their_formulas():
    nominal = frames(5, 2)
    actual = moved(nominal, 0.4, 3)
    found = {coding: np.asarray(encode_rows(coding, poses(nominal), poses(actual))) for coding in CODINGS}
    for row, (n, a) in enumerate(zip(nominal, actual, strict=True)):
        body, spatial = logm(np.linalg.inv(n) @ a), logm(a @ np.linalg.inv(n))
        np.testing.assert_allclose(matrix_of(found["body_twist"][row]), np.real(body), atol=1e-10)
        np.testing.assert_allclose(matrix_of(found["spatial_twist"][row]), np.real(spatial), atol=1e-10)
        turn = Rotation.from_matrix(a[:3, :3] @ n[:3, :3].T).as_rotvec()
        np.testing.assert_allclose(found["split"][row], [*(a - n)[:3, 3], *turn], atol=1e-12)
