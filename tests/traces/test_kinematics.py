import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palmar.traces.kinematics import (
    conjugate,
    finger_jacobian,
    finger_points,
    multiply,
    phalanges_in_palm,
    rotate,
)


def turn_about(points, axis, centre, angle):
    """Rodrigues' formula."""
    p = points - centre
    return (
        centre + p * np.cos(angle) + np.cross(axis, p) * np.sin(angle) + np.outer(p @ axis, axis) * (1 - np.cos(angle))
    )


def phalanges_by_carrying(hand, flexion, abduction):
    """The convention read literally: turn after turn, each about the axis where the turns before have carried it."""
    fingers = []
    for f in range(5):
        phalanx, joint = hand.phalanx_m[f].copy(), hand.joint_m[f].copy()
        axes = np.vstack([hand.abduction_axis[f], hand.flexion_axis[f]])
        for k, angle in enumerate([abduction[f], *flexion[f]]):
            first = max(k - 1, 0)  # the first phalanx and joint that this turn moves
            axis, centre = axes[k].copy(), joint[first].copy()
            phalanx[first:] = turn_about(phalanx[first:].reshape(-1, 3), axis, centre, angle).reshape(-1, 2, 3)
            joint[first:] = turn_about(joint[first:], axis, centre, angle)
            axes[k:] = turn_about(axes[k:], axis, np.zeros(3), angle)
        fingers.append(phalanx)
    return np.array(fingers)


def random_angles(hand, seed, count=20):
    generator = np.random.default_rng(seed)
    return generator.uniform(-0.2, 1.8, (count, 5, 3)), generator.uniform(-0.4, 0.4, (count, 5))


def test_phalanges_are_where_carried_axes_take_them(hand):
    flexion, abduction = random_angles(hand, 0)
    expected = np.array([phalanges_by_carrying(hand, f, a) for f, a in zip(flexion, abduction, strict=True)])
    # 1e-15 m: a few roundings of coordinates of 0.2 m
    np.testing.assert_allclose(phalanges_in_palm(hand, flexion, abduction), expected, rtol=0, atol=1e-15)


def test_parallel_flexions_add_up(hand):
    flexion = np.zeros((1, 5, 3))
    flexion[0, 1] = [0.3, 0.5, 0.2]
    end = phalanges_in_palm(hand, flexion, np.zeros((1, 5)))[0, 1, 2, 1]
    turned = np.cumsum([0.3, 0.5, 0.2])
    length = np.array([0.042, 0.025, 0.022])
    expected = [0.028, 0.088 + length @ np.cos(turned), -length @ np.sin(turned)]
    np.testing.assert_allclose(end, expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize("finger", range(5))
def test_jacobian_is_the_derivative_of_the_points(hand, finger):
    angles = np.random.default_rng(finger).uniform(-0.2, 1.5, (10, 4))
    step = 1e-5
    difference = np.stack(
        [
            (finger_points(hand, finger, angles + step * e) - finger_points(hand, finger, angles - step * e))
            / (2 * step)
            for e in np.eye(4)
        ],
        axis=3,
    )
    # Central differences are right to lever * step^2 / 6 + rounding / step: 1e-11 m/rad each.
    np.testing.assert_allclose(finger_jacobian(hand, finger, angles), difference, rtol=0, atol=5e-11)


def test_quaternions_agree_with_rotation_matrices():
    generator = np.random.default_rng(1)
    a, b = Rotation.random(30, generator), Rotation.random(30, generator)
    vectors = generator.normal(size=(30, 3))
    a_wxyz, b_wxyz = (np.roll(r.as_quat(), 1, axis=1) for r in (a, b))
    np.testing.assert_allclose(rotate(a_wxyz, vectors), a.apply(vectors), rtol=0, atol=1e-14)
    product = np.roll(multiply(a_wxyz, conjugate(b_wxyz)), -1, axis=1)
    np.testing.assert_allclose(Rotation.from_quat(product).as_matrix(), (a * b.inv()).as_matrix(), rtol=0, atol=1e-14)
