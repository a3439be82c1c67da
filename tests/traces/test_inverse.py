import numpy as np

from palmar.traces.inverse import KEEP_M_PER_RAD, fit_finger
from palmar.traces.kinematics import finger_points


def test_fit_leaves_a_finger_that_is_there_already(hand):
    angles = np.random.default_rng(3).uniform(-0.1, 1.3, (50, 4)) * [0.2, 1, 1, 1]
    fitted = fit_finger(hand, 4, finger_points(hand, 4, angles), near_rad=angles)
    # 1e-9 rad: the step at which the search ends
    np.testing.assert_allclose(fitted, angles, rtol=0, atol=1e-9)


def test_no_angles_near_a_fit_are_better(hand):
    generator = np.random.default_rng(4)
    low, high = np.array([-0.4, -0.2, -0.2, -0.2]), np.array([0.4, 1.8, 1.8, 1.8])
    start = generator.uniform(low, high, (200, 4))
    # Points of a finger whose knuckle has moved by up to 15 mm, which no angles reach.
    points = finger_points(hand, 4, start) + generator.uniform(-0.015, 0.015, (200, 1, 3))

    def cost(angles):
        miss = ((finger_points(hand, 4, angles) - points) ** 2).sum((1, 2))
        return miss + KEEP_M_PER_RAD**2 * ((angles - start) ** 2).sum(1)

    fitted = fit_finger(hand, 4, points, near_rad=start)
    assert (fitted >= low).all() and (fitted <= high).all()
    for size in (1e-4, 1e-2):
        for _ in range(30):
            near = np.clip(fitted + size * generator.normal(size=fitted.shape), low, high)
            assert (cost(fitted) <= cost(near) + 1e-15).all()  # 1e-15 m^2: (0.03 um)^2, a rounding of the sum
