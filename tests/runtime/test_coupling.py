"""Angles that a device does not read come from those it does, by the hand's coupling."""

from dataclasses import replace

import numpy as np
import pytest

from palmar.coupling import complete_flexion
from palmar.errors import BadTrace
from palmar.model import AssetPack, load_pack, save_pack
from palmar.tools.hand_file import default_hand

HAND = default_hand()
NAN = np.nan


def finger(*angles):
    """A sample whose index finger has these angles; the others are read in full."""
    flexion = np.full((1, 5, 3), 0.3)
    flexion[0, 1] = angles
    return flexion


@pytest.mark.parametrize(
    ("read", "expected"),
    [
        ((0.5, NAN, NAN), (0.5, 0.5 * 1.11, 0.5 * 1.11 * 0.667)),
        ((0.5, 0.2, NAN), (0.5, 0.2, 0.2 * 0.667)),
        ((NAN, 0.6, NAN), (0.6 / 1.11, 0.6, 0.6 * 0.667)),
        ((NAN, NAN, 0.4), (0.4 / 0.667 / 1.11, 0.4 / 0.667, 0.4)),
        ((0.5, NAN, 0.1), (0.5, 0.5 * 1.11, 0.1)),
        ((0.1, 0.2, 0.3), (0.1, 0.2, 0.3)),
    ],
)
def test_missing_joints_follow_the_nearest_that_is_read(read, expected):
    # 1e-15 rad: two roundings
    np.testing.assert_allclose(complete_flexion(HAND, finger(*read))[0, 1], expected, rtol=0, atol=1e-15)


def test_only_what_is_filled_is_held_to_the_limits():
    # Stretched back, MCP alone is read: PIP and DIP stay straight. What was read beyond a limit is kept.
    np.testing.assert_array_equal(complete_flexion(HAND, finger(-0.9, NAN, NAN))[0, 1], [-0.9, 0.0, 0.0])
    full = complete_flexion(HAND, finger(2.0, NAN, NAN))[0, 1]
    assert full[0] == 2.0 and full[1] == HAND.flexion_limit_rad[1, 1, 1]


def test_a_finger_without_a_reading_is_named():
    with pytest.raises(BadTrace, match="sample 0, index"):
        complete_flexion(HAND, finger(NAN, NAN, NAN))


def test_a_fist_and_an_open_hand_are_reached_from_one_joint():
    high = HAND.flexion_limit_rad[..., 1]
    fist = np.where(np.arange(3) == 0, high, NAN)[None]
    filled = complete_flexion(HAND, fist)[0]
    # PIP per MCP is the ratio of their ranges to two decimals, so PIP ends within 1 % of its range.
    np.testing.assert_allclose(filled[:, 1], high[:, 1], rtol=0.01)
    straight = np.where(np.arange(3) == 0, np.zeros((5, 3)), NAN)[None]
    np.testing.assert_array_equal(complete_flexion(HAND, straight)[0], 0.0)


def test_a_pack_keeps_the_coupling_and_one_without_it_gets_the_default(tmp_path):
    from safetensors.numpy import load_file, save_file

    ratio = np.linspace(0.5, 1.4, 10).reshape(5, 2)
    save_pack(tmp_path / "a.pack", AssetPack(replace(HAND, flexion_coupling=ratio), {}, {}))
    pack = load_pack(tmp_path / "a.pack")
    np.testing.assert_array_equal(pack.hand.flexion_coupling, ratio)

    import json

    tensors = load_file(tmp_path / "a.pack")
    del tensors["hand/flexion_coupling"]
    save_file(tensors, tmp_path / "b.pack", {"palmar": json.dumps(pack.manifest)})
    np.testing.assert_array_equal(load_pack(tmp_path / "b.pack").hand.flexion_coupling, HAND.flexion_coupling)
