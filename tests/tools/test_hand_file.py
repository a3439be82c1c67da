"""Hands as TOML: the reference hand is what it says, the default hand is a hand, and what is wrong is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from palmar.errors import BadPack
from palmar.tools.hand_file import default_hand, read_hand, side_of

REFERENCE = Path(__file__).resolve().parents[1] / "data" / "reference_hand.toml"


def write(folder: Path, change) -> Path:
    path = folder / "hand.toml"
    path.write_text(change(REFERENCE.read_text()))
    return path


def refusal(folder: Path, old: str, new: str, count: int = 1) -> BadPack:
    assert old in REFERENCE.read_text()
    with pytest.raises(BadPack) as caught:
        read_hand(write(folder, lambda text: text.replace(old, new, count)))
    assert "\n" not in str(caught.value) and "hand.toml" in caught.value.where
    return caught.value


def test_the_reference_hand_has_its_99_palm_balls():
    palm = read_hand(REFERENCE).palm_spheres_m
    expected = {(x, y) for x in np.linspace(-36, 36, 9) for y in np.linspace(4, 84, 11)}
    assert palm.shape == (99, 4)
    assert {(round(x, 6), round(y, 6)) for x, y in palm[:, :2] * 1000} == {
        (round(x, 6), round(y, 6)) for x, y in expected
    }
    assert (palm[:, 2] == 0).all() and (palm[:, 3] == 0.011).all()


def test_the_reference_hand_has_its_capsules():
    hand = read_hand(REFERENCE)
    base = np.array([[28, 22, -6], [28, 88, 0], [9.5, 92, 0], [-9.5, 87, 0], [-28, 78, 0]]) / 1000
    length = np.array([[44, 34, 27], [42, 25, 22], [46, 29, 23], [42, 27, 23], [33, 20, 20]]) / 1000
    radius = np.array([[11, 10, 8.5], [9, 8, 7], [9, 8, 7], [9, 8, 7], [8, 7, 6]]) / 1000
    direction = np.array([[0.70, 0.62, -0.35]] + [[0, 1, 0]] * 4)
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    axis = np.array([np.cross(direction[0], [-0.75, 0.15, -0.65])] + [[-1, 0, 0]] * 4)
    axis = axis / np.linalg.norm(axis, axis=1, keepdims=True)
    # 1e-15 m and less: rounding of a sum of three products.
    np.testing.assert_allclose(hand.joint_m[:, 0], base, atol=1e-15)
    np.testing.assert_allclose(np.diff(hand.joint_m, axis=1), length[:, :2, None] * direction[:, None], atol=1e-15)
    np.testing.assert_allclose(hand.phalanx_m[:, :, 0], hand.joint_m, atol=0)
    np.testing.assert_allclose(hand.phalanx_m[:, :2, 1], hand.joint_m[:, 1:], atol=0)
    np.testing.assert_allclose(hand.phalanx_m[:, 2, 1] - hand.joint_m[:, 2], length[:, 2, None] * direction, atol=1e-15)
    np.testing.assert_array_equal(hand.phalanx_radius_m, np.stack([radius, radius], axis=2))
    np.testing.assert_allclose(hand.flexion_axis, np.repeat(axis[:, None], 3, axis=1), atol=1e-15)
    assert hand.palm_stiffness_n_per_m == 1000 and (hand.joint_stiffness_n_m_per_rad == 0.5).all()


def test_the_default_hand_is_a_right_hand_of_the_cited_size():
    hand = default_hand()
    assert hand.about["side"] == side_of(hand) == "right"
    # Its tip is rounded to 0.1 mm from the cited lengths.
    assert hand.phalanx_m[2, 2, 1, 1] + hand.phalanx_radius_m[2, 2, 1] == pytest.approx(0.1872, abs=2e-4)
    palm = hand.palm_spheres_m
    assert (palm[:, 0] + palm[:, 3]).max() - (palm[:, 0] - palm[:, 3]).min() == pytest.approx(0.0833, abs=2e-4)
    assert 80 <= len(palm) <= 130
    assert (hand.phalanx_radius_m[:, :, 0] > hand.phalanx_radius_m[:, :, 1]).all()
    assert np.array_equal(hand.phalanx_radius_m[:, :2, 1], hand.phalanx_radius_m[:, 1:, 0])


@pytest.mark.parametrize("hand", [default_hand(), read_hand(REFERENCE)], ids=["default", "reference"])
def test_axes_are_unit_and_bend_and_spread_as_written_down(hand):
    for axes in (hand.flexion_axis, hand.abduction_axis):
        np.testing.assert_allclose(np.linalg.norm(axes, axis=-1), 1, atol=1e-15)
    direction = hand.phalanx_m[:, 0, 1] - hand.phalanx_m[:, 0, 0]
    np.testing.assert_allclose(np.einsum("ij,ij->i", hand.abduction_axis, direction), 0, atol=1e-15)
    # A positive flexion moves every tip to the palm's inner side, -z; a positive abduction to the thumb's side.
    assert (np.cross(hand.flexion_axis[:, 0], direction)[:, 2] < 0).all()
    radial = hand.joint_m[1, 0] - hand.joint_m[4, 0]
    assert (np.cross(hand.abduction_axis, direction) @ radial > 0).all()
    assert (hand.flexion_limit_rad[..., 0] < hand.flexion_limit_rad[..., 1]).all()


def test_a_hand_may_be_given_by_joints_and_phalanges(tmp_path):
    hand = read_hand(REFERENCE)
    text = REFERENCE.read_text()
    for f in range(5):
        start = text.index("base_m", text.index("[[finger]]", 0 if f == 0 else text.index(f"# done {f - 1}")))
        end = text.index("radius_m", start)
        explicit = f"joint_m = {hand.joint_m[f].tolist()}\nphalanx_m = {hand.phalanx_m[f].tolist()}\n"
        explicit += f"flexion_axis = {hand.flexion_axis[f].tolist()}\n# done {f}\n"
        text = text[:start] + explicit + text[end:]
    again = read_hand(write(tmp_path, lambda _: text))
    for name in ("joint_m", "phalanx_m", "phalanx_radius_m", "palm_spheres_m"):
        assert np.array_equal(getattr(again, name), getattr(hand, name)), name
    np.testing.assert_allclose(again.flexion_axis, hand.flexion_axis, atol=1e-15)


def test_palm_spheres_come_from_a_list_or_a_csv_too(tmp_path):
    start, end = "[palm.grid]", "[[finger]]"
    text = REFERENCE.read_text()
    head, rest = text[: text.index(start)], text[text.index(end) :]
    listed = read_hand(
        write(tmp_path, lambda _: f"{head}[palm]\nspheres_m = [[0, 0.04, 0, 0.02], [0, 0.06, 0, 0.01]]\n{rest}")
    )
    (tmp_path / "palm.csv").write_text("x,y,z,r\n0,0.04,0,0.02\n0,0.06,0,0.01\n")
    from_csv = read_hand(write(tmp_path, lambda _: f'{head}[palm]\nspheres_csv = "palm.csv"\n{rest}'))
    assert np.array_equal(listed.palm_spheres_m, from_csv.palm_spheres_m) and len(listed.palm_spheres_m) == 2


def test_radii_are_given_for_phalanges_pairs_or_joints(tmp_path):
    for given, expected in (
        ("[[0.009, 0.008], [0.008, 0.0075], [0.0075, 0.006]]", [[0.009, 0.008], [0.008, 0.0075], [0.0075, 0.006]]),
        ("[0.009, 0.008, 0.0075, 0.006]", [[0.009, 0.008], [0.008, 0.0075], [0.0075, 0.006]]),
    ):
        hand = read_hand(write(tmp_path, lambda text, r=given: text.replace("[0.009, 0.008, 0.007]", r, 1)))
        assert np.array_equal(hand.phalanx_radius_m[1], expected)


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ("length_m", "lenght_m", "finger[0].lenght_m"),
        ("[0.042, 0.025, 0.022]", "[0.042, 0.025]", "finger[1].length_m"),
        ("[0.042, 0.025, 0.022]", "[0.042, 0.025, nan]", "finger[1].length_m"),
        ("[0.042, 0.025, 0.022]", '[0.042, 0.025, "x"]', "finger[1].length_m"),
        ("[0.042, 0.025, 0.022]", "[0.042, 0.025, [0.022]]", "finger[1].length_m"),
        ("[0.042, 0.025, 0.022]", "[0.042, 0, 0.022]", "finger[1].length_m"),
        ("[0.042, 0.025, 0.022]", "[0.042, -0.025, 0.022]", "finger[1].length_m"),
        ("[0.009, 0.008, 0.007]", "[0.009, 0, 0.007]", "finger[1].radius_m[1]"),
        ("[0.009, 0.008, 0.007]", "[9, 8, 7]", "finger[1].radius_m[0]"),
        ("[0.009, 0.008, 0.007]", "[[0.045, 0.001], [0.008, 0.008], [0.007, 0.007]]", "finger[1].length_m[0]"),
        ("direction = [0, 1, 0]", "direction = [0, 0, 0]", "finger[1].direction"),
        ("[-0.75, 0.15, -0.65]", "[0.70, 0.62, -0.35]", "finger[0].bends_towards"),
        ("flexion_axis = [-1, 0, 0]", "", "finger[1]"),
        ("[[-45, 90]", "[[90, -45]", "finger[0].flexion_limit_deg"),
        ("[[-45, 90]", "[[-45, 190]", "finger[0].flexion_limit_deg"),
        ("abduction_limit_deg = [-60, 60]", "", "finger[0]"),
        ('name = "index"', 'name = "ring"', "finger[1].name"),
        ('side = "left"', 'side = "right"', "side"),
        ('side = "left"', 'side = "both"', "side"),
        ("radius_m = 0.011", "radius_m = 0.0", "palm.grid.radius_m"),
        ("counts = [9, 11]", "counts = [9, 0]", "palm.grid.counts"),
        ("[palm.grid]", "[stiffness]\njoint_n_m_per_rad = -1\n[palm.grid]", "stiffness.joint_n_m_per_rad"),
        ("[palm.grid]", '[palm]\nspheres_csv = "a.csv"\n[palm.grid]', "palm"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, old, new, place):
    error = refusal(tmp_path, old, new)
    assert error.code == "E-CONF" and error.where.endswith(place)


def test_the_nearest_known_key_is_offered(tmp_path):
    assert "nearest: length_m" in refusal(tmp_path, "length_m", "lenght_m").message


def test_a_hand_in_millimetres_is_refused_as_too_large(tmp_path):
    def in_millimetres(text: str) -> str:
        text = text.replace("base_m = [0.0", "base_m = [18.0")
        return text

    with pytest.raises(BadPack, match=r"E-CONF .* in metres"):
        read_hand(write(tmp_path, in_millimetres))


def test_four_fingers_broken_toml_and_a_missing_file_are_refused(tmp_path):
    text = REFERENCE.read_text()
    for content in (text[: text.rindex("[[finger]]")], text.replace("[palm.grid]", "[palm.grid"), ""):
        with pytest.raises(BadPack, match="E-CONF"):
            read_hand(write(tmp_path, lambda _, content=content: content))
    with pytest.raises(BadPack, match="E-CONF-MISSING"):
        read_hand(tmp_path / "none.toml")
