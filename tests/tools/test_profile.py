"""Profiles: read, refused, applied; the built-in hands are what the survey says."""

from dataclasses import replace

import numpy as np
import pytest

from palmar.errors import BadPack, PalmarError
from palmar.model import FINGERS, load_pack
from palmar.profile import (
    FingerMeasures,
    Profile,
    bone_vectors,
    fit_to_profile,
    hand_breadth,
    hand_length,
    mirror_hand,
    other_hand_warning,
)
from palmar.tools.default_hands import NAMES, find_hand
from palmar.tools.hand_file import default_hand, side_of
from palmar.tools.pack import build
from palmar.tools.profile_file import profile_toml, read_profile

FULL = Profile(
    name='Anna "A"',
    side="right",
    source="ruler",
    hand_length_m=0.18,
    hand_breadth_m=0.08,
    fingers=(
        FingerMeasures(length_m=np.array([0.045, 0.03, 0.018]), width_m=np.array([0.026, 0.022, 0.02, 0.016])),
        FingerMeasures(
            length_m=np.array([0.04, 0.022, 0.013]),
            length_spread_m=np.array([0.0004, 0.0, 0.0001]),
            joint_m=np.array([-0.03, 0.09, 0.001]),
            flexion_axis=np.array([[-1.0, 0.0, 0.0], [-0.8, 0.0, 0.6], [-1.0, 0.0, 0.0]]),
            abduction_axis=np.array([0.0, 0.0, 1.0]),
            flexion_limit_rad=np.radians([[-30, 95], [0, 105], [-10, 80]]),
            abduction_limit_rad=np.radians([-20, 30]),
            reading_rad=np.array([[0.0, 1.5], [0.1, 1.6], [0.0, 0.0]]),
            marker_m=np.array([[-0.03, 0.12, 0.015], [-0.03, 0.16, 0.01]]),
        ),
        *[FingerMeasures()] * 3,
    ),
    device="glove",
    palm_from_device=(np.array([0.01, 0.02, 0.03]), np.array([0.6, 0.0, 0.8, 0.0])),
)


WITHOUT_PLACES = replace(FULL, fingers=(FULL.fingers[0], *[FingerMeasures()] * 4))


def write(path, text):
    path.write_text(text)
    return path


def test_a_profile_comes_back_as_it_was_written(tmp_path):
    read = read_profile(write(tmp_path / "p.toml", profile_toml(FULL)))
    for name in ("name", "side", "source", "hand_length_m", "hand_breadth_m", "device"):
        assert getattr(read, name) == getattr(FULL, name)
    for wrote, got in zip(FULL.fingers, read.fingers, strict=True):
        for name, value in vars(wrote).items():
            if value is None:
                assert getattr(got, name) is None
            else:  # micrometres, and thousandths of a degree
                np.testing.assert_allclose(getattr(got, name), value, rtol=0, atol=1e-6 if "_rad" not in name else 2e-5)
    np.testing.assert_allclose(read.palm_from_device[1], FULL.palm_from_device[1], atol=1e-9)
    # Written again it is the same file, so its hash names it.
    assert profile_toml(read) == profile_toml(FULL)


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        ("palmar.profile/1", "palmar.profile/2", "schema 'palmar.profile/2'|'palmar.profile/2'; 'palmar.profile/1'"),
        ('schema = "palmar.profile/1"\n', "", "missing; 'palmar.profile/1'"),
        ("hand_length_m", "hand_lenght_m", "unknown key; nearest: hand_length_m"),
        ("length_spread_m", "spread_m", "unknown key"),
        ("hand_length_m = 0.18", "hand_length_m = 180", "up to 0.5 is needed"),
        ("[0.04, 0.022, 0.013]", "[40, 22, 13]", "length_m 40; 0.002 to 0.15|40; 0.002 to 0.15"),
        ("[0.04, 0.022, 0.013]", "[0.04, 0.022]", "3 finite numbers"),
        ("[0.04, 0.022, 0.013]", "[0.04, nan, 0.013]", "3 finite numbers"),
        ("[0.0, 0.0, 1.0]", "[0.0, 0.0, 0.5]", "length 1"),
        ("[-20.0, 30.0]", "[30.0, -20.0]", "lowest below highest"),
        ('name = "index"', 'name = "thumb"', "twice"),
        ('name = "index"', 'name = "toe"', "one of thumb"),
        ('side = "right"', 'side = "both"', "one of right, left"),
        ('[device]\nname = "glove"\n', "[device]\n", "is missing"),
        ("palm_position_m = [0.01, 0.02, 0.03]\n", "", "together"),
        ("0.6, 0.0, 0.8", "0.6, 0.0, 0.9", "a rotation has 1"),
    ],
)
def test_a_profile_with_a_fault_is_refused_in_one_line(old, new, found, tmp_path):
    text = profile_toml(FULL)
    assert old in text
    with pytest.raises(BadPack, match=found) as caught:
        read_profile(write(tmp_path / "p.toml", text.replace(old, new, 1)))
    assert "\n" not in str(caught.value) and caught.value.exit_code == 2


def test_readings_without_a_device_are_refused(tmp_path):
    text = profile_toml(FULL)
    with pytest.raises(BadPack, match="device"):
        read_profile(write(tmp_path / "p.toml", text[: text.index("[device]")]))


def test_measures_are_the_hands_to_rounding():
    hand = fit_to_profile(default_hand(), FULL)
    for f in (0, 1):
        found = np.linalg.norm(bone_vectors(hand, f), axis=1)
        np.testing.assert_allclose(found, FULL.fingers[f].length_m, rtol=0, atol=1e-15)
    np.testing.assert_allclose(hand.phalanx_radius_m[0, :, 0] * 2, [0.026, 0.022, 0.02], atol=1e-15)
    np.testing.assert_allclose(hand.phalanx_radius_m[0, :, 1] * 2, [0.022, 0.02, 0.016], atol=1e-15)
    np.testing.assert_array_equal(hand.joint_m[1, 0], FULL.fingers[1].joint_m)
    np.testing.assert_array_equal(hand.flexion_axis[1], FULL.fingers[1].flexion_axis)
    np.testing.assert_array_equal(hand.abduction_limit_rad[1], np.radians([-20, 30]))
    assert hand_length(hand) == pytest.approx(0.18, abs=1e-12)
    # The palm's breadth is the measured one but for how far the index finger's knuckle was found from its usual place.
    moved = np.linalg.norm(hand.joint_m[1, 0] - fit_to_profile(default_hand(), WITHOUT_PLACES).joint_m[1, 0])
    assert abs(hand_breadth(hand) - 0.08) <= moved
    assert hand_breadth(fit_to_profile(default_hand(), WITHOUT_PLACES)) == pytest.approx(0.08, abs=1e-12)


def test_the_palm_follows_its_knuckles_and_not_at_the_wrist():
    own = default_hand()
    shift = np.array([0.002, 0.003, -0.004])
    fingers = tuple(FingerMeasures(joint_m=own.joint_m[f, 0] + shift) for f in range(5))
    hand = fit_to_profile(own, Profile("a", "right", "", fingers=fingers))
    moved = hand.palm_spheres_m[:, :3] - own.palm_spheres_m[:, :3]
    share = np.clip(own.palm_spheres_m[:, 1] / 0.0834, 0, 1)  # the little finger's knuckle is the nearest to the wrist
    assert (moved @ shift <= share * (shift @ shift) + 1e-12).all() and (moved @ shift > 0).all()
    knuckle = np.argmin(np.linalg.norm(own.palm_spheres_m[:, :3] - own.joint_m[2, 0], axis=1))
    np.testing.assert_allclose(moved[knuckle], shift, rtol=0.05)


def test_a_longer_middle_finger_leaves_less_palm():
    lengths = np.array([0.05, 0.03, 0.018])
    fingers = (FingerMeasures(), FingerMeasures(), FingerMeasures(length_m=lengths), FingerMeasures(), FingerMeasures())
    hand = fit_to_profile(default_hand(), Profile("a", "right", "", hand_length_m=0.18, fingers=fingers))
    assert hand_length(hand) == pytest.approx(0.18, abs=1e-12)
    assert hand.joint_m[2, 0, 1] == pytest.approx(0.18 - lengths.sum() - hand.phalanx_radius_m[2, 2, 1], abs=1e-12)


@pytest.mark.parametrize(
    ("profile", "found"),
    [
        (Profile("a", "right", "", hand_length_m=0.05), "hand_length_m"),
        (Profile("a", "right", "", hand_breadth_m=0.3), "hand_breadth_m"),
        (
            Profile("a", "right", "", fingers=(FingerMeasures(length_m=np.array([0.15, 0.03, 0.02])),) * 5),
            "thumb, length_m",
        ),
        (
            Profile("a", "right", "", fingers=(FingerMeasures(width_m=np.array([0.09, 0.09, 0.09, 0.004])),) * 5),
            "longer than they differ",
        ),
    ],
)
def test_what_fits_no_hand_is_refused(profile, found):
    with pytest.raises(BadPack, match=found):
        fit_to_profile(default_hand(), profile)


def test_a_mirrored_hand_is_the_other_one_and_bends_alike():
    hand = default_hand()
    left = mirror_hand(hand)
    assert side_of(left) == left.about["side"] == "left"
    flip = np.diag([-1.0, 1.0, 1.0])
    np.testing.assert_allclose(left.joint_m, hand.joint_m @ flip, atol=1e-15)
    # Flexion still brings the fingertip to the palm's inner side: where the mirrored tip goes.
    for f in range(5):
        bone = bone_vectors(hand, f)[0]
        there = np.cross(hand.flexion_axis[f, 0], bone) @ flip
        np.testing.assert_allclose(np.cross(left.flexion_axis[f, 0], bone @ flip), there, atol=1e-15)
    back = mirror_hand(left)
    np.testing.assert_allclose(back.palm_spheres_m, hand.palm_spheres_m, atol=1e-15)


# Gordon et al. 2014: mean and deviation of the length, mean breadth, mm; percentiles of a normal distribution.
SURVEY = {"female": (181.1, 10.1, 78.2), "male": (193.3, 9.9, 88.3)}


@pytest.mark.parametrize("name", NAMES[1:])
def test_built_in_hands_have_the_surveys_length_and_breadth(name):
    sex, percentile = name.removeprefix("default:").split("-")
    length, deviation, breadth = SURVEY[sex]
    deviate = {"5": -1.645, "50": 0.0, "95": 1.645}[percentile]
    hand = find_hand(name)
    assert hand.about["name"] == f"{sex}-{percentile}" and "Gordon" in hand.about["source"]
    assert hand_length(hand) * 1e3 == pytest.approx(length + deviate * deviation, abs=1e-9)
    assert hand_breadth(hand) * 1e3 == pytest.approx(breadth * (1 + deviate * deviation / length), abs=1e-9)
    # Everything else is in the proportion of the default hand: lengths along with the palm, radii with the breadth.
    own = default_hand()
    along = np.array([np.linalg.norm(bone_vectors(hand, f), axis=1) for f in range(5)])
    along = along / np.array([np.linalg.norm(bone_vectors(own, f), axis=1) for f in range(5)])
    np.testing.assert_allclose(along, along[0, 0], rtol=1e-12)
    np.testing.assert_allclose(
        hand.phalanx_radius_m / own.phalanx_radius_m, hand_breadth(hand) / hand_breadth(own), rtol=1e-12
    )


def test_radii_of_the_mean_man_are_the_circumferences_of_his_joints():
    # Greiner 1991, men, at a hand breadth of 90.4 mm: circumference of PIP and DIP of the middle finger, from which the
    # default hand's radii are (10.2 and 8.5 mm at 83.3); at 88.3 they are these, to the rounding of the default's.
    radius = find_hand("default:male-50").phalanx_radius_m[2] * 1e3
    assert radius[1, 0] == pytest.approx(10.2 * 88.3 / 83.3, abs=0.06)
    assert radius[2, 0] == pytest.approx(8.5 * 88.3 / 83.3, abs=0.06)


def test_a_profile_tells_the_hand_it_was_made_with(tmp_path):
    made = replace(FULL, hand="median adult")
    assert read_profile(write(tmp_path / "me.toml", profile_toml(made))).hand == "median adult"
    assert other_hand_warning(default_hand(), made) == ""
    assert other_hand_warning(default_hand(), FULL) == ""  # of a profile that does not say
    assert "made with hand 'median adult', not 'male-95'" in other_hand_warning(find_hand("default:male-95"), made)


def test_a_hand_that_is_not_built_in_is_named_with_those_that_are():
    with pytest.raises(PalmarError, match="nearest: default:female-5; known are default"):
        find_hand("default:female-55")


def test_a_pack_says_whose_hand_it_holds(tmp_path):
    profile = write(tmp_path / "me.toml", profile_toml(FULL))
    build(["shape:cube"], tmp_path / "a.pack", spheres=30, hand_path="default:male-95", profile_path=profile)
    hand = load_pack(tmp_path / "a.pack").hand
    assert hand.about["profile_sha256"] == read_profile(profile).sha256
    assert hand.about["name"] == FULL.name and "male-95" in hand.about["source"]
    expected = fit_to_profile(find_hand("default:male-95"), read_profile(profile))
    np.testing.assert_array_equal(hand.phalanx_m, expected.phalanx_m)
    assert FINGERS[1] == "index"
    # A hand out of a pack is a hand like any other, whatever the file is called, and a profile fits it again.
    other_name = (tmp_path / "a.pack").rename(tmp_path / "anna.toml")
    build(["shape:cube"], tmp_path / "c.pack", spheres=30, hand_path=other_name, profile_path=profile)
    again = load_pack(tmp_path / "c.pack").hand
    np.testing.assert_allclose(bone_vectors(again, 1), bone_vectors(expected, 1), rtol=0, atol=1e-15)
    assert again.about["source"].startswith(f"{FULL.name}, fitted to")
    assets = write(
        tmp_path / "assets.toml", 'hand = "default:female-5"\n[[object]]\nmesh = "shape:cube"\nspheres = 30\n'
    )
    build([assets], tmp_path / "b.pack")
    assert load_pack(tmp_path / "b.pack").hand.about["name"] == "female-5"
