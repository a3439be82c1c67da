"""A small hand, boxes, and runs made step by step for the tests of the judge and the metrics."""

import json
from functools import partial

import numpy as np
import pytest
from small import small_hand, small_pack

from palmar.records import Run


@pytest.fixture
def hand():
    """Five straight fingers along y, 20 mm apart, phalanges of 30 mm, radii 8 to 6 mm; 4 palm spheres of 10 mm."""
    return small_hand()


@pytest.fixture
def make_pack(hand):
    return partial(small_pack, hand)


@pytest.fixture
def make_run():
    """make(n, phases, contact_links={step: [links]}, **columns); haptic columns are the graphic ones unless given."""

    def make(n, phases=(), contact_links=None, header=None, **columns):
        def rest(*shape):
            return np.zeros((n, *shape))

        pose = {
            "palm_position_m": rest(3),
            "palm_rotation_wxyz": np.tile([1.0, 0, 0, 0], (n, 1)),
            "flexion_rad": rest(5, 3),
            "abduction_rad": rest(5),
        }
        pose |= {name: columns.pop(name) for name in list(columns) if name in pose}
        links = [list((contact_links or {}).get(step, [])) for step in range(n)]
        count = sum(map(len, links))
        values = {
            "header": {"phases": json.dumps(list(phases))} | (header or {}),
            "time_s": 1e-3 * np.arange(n),
            "status": np.zeros(n, dtype=np.uint32),
            **pose,
            **{f"haptic_{name}": value.copy() for name, value in pose.items()},
            "object_position_m": rest(3),
            "object_rotation_wxyz": np.tile([1.0, 0, 0, 0], (n, 1)),
            "palm_force_n": rest(3),
            "palm_torque_n_m": rest(3),
            "joint_torque_n_m": rest(5, 3),
            "fingertip_force_n": rest(5, 3),
            "equation14_force_n": rest(5, 3),
            "contacts": np.array([len(each) for each in links], dtype=np.uint32),
            "operations": np.zeros(n, dtype=np.uint32),
            "state_hash": np.zeros(n, dtype=np.uint64),
            **{name: np.full(n, 10.0) for name in ("cpu_us", "wall_us", "search_us", "solve_us", "verify_us")},
            "contact_start": np.concatenate([[0], np.cumsum([len(each) for each in links])]).astype(np.int64),
            "contact_link": np.array([link for each in links for link in each], dtype=np.uint8),
            "contact_object_sphere": np.zeros(count, dtype=np.uint32),
            "contact_palm_sphere": np.zeros(count, dtype=np.uint32),
            "contact_gap_m": np.zeros(count),
            "contact_force_n": np.zeros(count),
            "contact_point_m": np.zeros((count, 3)),
            "contact_normal": np.zeros((count, 3)),
        }
        return Run(**(values | columns))

    return make
