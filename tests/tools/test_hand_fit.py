"""A hand of known capsules comes back from its mesh; what is no rigged hand is refused in one line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_limits

from palmar.errors import PalmarError
from palmar.model import load_pack
from palmar.skin import link_motions
from palmar.tools.capsule_fit import capsule_gap
from palmar.tools.gltf_skin import read_skin
from palmar.tools.hand_file import default_hand
from palmar.tools.hand_fit import fit_hand, fit_model, hand_mesh
from palmar.tools.hand_frame import make_frame
from palmar.tools.hand_joints import read_joints
from palmar.tools.hand_quality import capsules_of
from palmar.tools.pack import build
from palmar.tools.rig import make_rig

SHARED = Path(__file__).resolve().parents[2].parent / "shared" / "data"


@pytest.fixture(scope="module")
def rigged(make_rigged):
    """Of the default hand, with noise of 0.2 mm along the normals."""
    return make_rigged(default_hand(), noise_m=2e-4)


@pytest.fixture(scope="module")
def fitted(rigged, write_rigged, tmp_path_factory):
    folder = tmp_path_factory.mktemp("fit")
    answer = fit_hand(write_rigged(folder / "known.glb", rigged), folder / "known.pack", spheres=100)
    return answer, load_pack(folder / "known.pack").hand, folder


def aligned(fitted_hand, true_hand):
    """Ends (15, 2, 3) and radii (15, 2) of both hands' capsules, the fitted one as its mesh was, joints on joints."""
    mesh = fitted_hand.mesh
    joints = (fitted_hand.joint_m, fitted_hand.flexion_axis, fitted_hand.abduction_axis)
    turns, shifts = link_motions(*joints, mesh.flexion_rad[None], np.zeros((1, 5)))
    found, known = capsules_of(fitted_hand), capsules_of(true_hand)
    ours = np.einsum("kab,kb->ka", turns[0, 1:], fitted_hand.joint_m.reshape(15, 3)) + shifts[0, 1:]
    ends = np.einsum("kab,kcb->kca", turns[0, 1:], found[:, :6].reshape(15, 2, 3)) + shifts[0, 1:, None]
    theirs = true_hand.joint_m.reshape(15, 3)
    turn, _ = Rotation.align_vectors(theirs - theirs.mean(axis=0), ours - ours.mean(axis=0))
    ends = turn.apply((ends - ours.mean(axis=0)).reshape(-1, 3)).reshape(15, 2, 3) + theirs.mean(axis=0)
    return ends, found[:, 6:], known[:, :6].reshape(15, 2, 3), known[:, 6:]


def thickness(ends, radii, true_ends, f):
    """Along the middle half of each phalanx of a finger: at a joint, what bends best is not what is thickest.

    The thumb's metacarpal lies in the ball of the thumb, where its thickness is not to be seen.
    """
    rows = slice(3 * f, 3 * f + 3)
    line = np.concatenate([a + np.linspace(0.25, 0.75, 9)[:, None] * (b - a) for a, b in true_ends[rows]][f == 0 :])
    return -np.min([capsule_gap(e, r, line)[0] for e, r in zip(ends[rows], radii[rows], strict=True)], axis=0)


def test_known_capsules_come_back(fitted):
    _, hand, _ = fitted
    true = default_hand()
    ends, radii, true_ends, true_radii = aligned(hand, true)
    bones = [np.linalg.norm(np.diff(h.joint_m, axis=1), axis=2) for h in (hand, true)]
    # The three figures are those that the fit is held to: 0.5 mm, 0.2 mm and 2 degrees.
    assert np.abs(bones[0] - bones[1]).max() < 5e-4
    axis, true_axis = (
        (e[:, 1] - e[:, 0]) / np.linalg.norm(e[:, 1] - e[:, 0], axis=1)[:, None] for e in (ends, true_ends)
    )
    angle = np.degrees(np.arccos(np.clip(np.einsum("ka,ka->k", axis, true_axis), -1, 1)))
    assert angle.max() < 2
    for f in range(5):
        thick = [thickness(*found, true_ends, f) for found in ((ends, radii), (true_ends, true_radii))]
        assert np.abs(thick[0] - thick[1]).max() < 2e-4, f
        tips = [
            e[3 * f + 2, 1] + r[3 * f + 2, 1] * a[3 * f + 2]
            for e, r, a in ((ends, radii, axis), (true_ends, true_radii, true_axis))
        ]
        assert np.linalg.norm(tips[0] - tips[1]) < 5e-4


def test_the_fit_is_measured_against_its_mesh(fitted):
    answer, hand, _ = fitted
    error = answer["hand"]["error"]
    for pose, limit in (("rest", 1.0), ("sweep", 2.5)):
        for figure in ("gap_mm", "protrusion_mm"):
            assert error[pose]["phalanges"][figure]["p99"] <= limit
            assert error[pose]["phalanges"][figure]["mean"] <= 0.35
    # The hand is made of such capsules: what is left is the noise and the palm's corner.
    assert 0.98 < error["volume_ratio"] < 1.02
    assert hand.mesh is not None and np.allclose(hand.mesh.weights.sum(axis=1), 1)


def test_a_mirrored_file_gives_the_mirrored_hand():
    if not SHARED.exists():
        pytest.skip("the shared data are not beside this checkout")
    file = read_skin(SHARED / "hands" / "webxr_generic_hand_right.glb")
    mirror = np.diag([-1.0, 1.0, 1.0])
    other = replace(
        file,
        vertices=file.vertices @ mirror,
        faces=file.faces[:, ::-1].copy(),
        joint=file.joint @ mirror,
        turn=mirror @ file.turn @ mirror,
        names=tuple(name.replace("right", "left") for name in file.names),
    )
    hands = {}
    for skinned in (file, other):
        rig = make_rig("hand", skinned)
        frame = make_frame("hand", rig)
        mesh = hand_mesh("hand", rig, frame, 1.0)
        with threadpool_limits(1):
            hands[frame.side] = fit_model("hand", frame, mesh, 20, 0, lambda text, part: None)
    left, right = hands["left"], hands["right"]
    # In the palm frame x is mirrored. The same points, weights and start: what is left is rounding, which least squares
    # makes larger; 0.1 mm is asked of two hands of a pair.
    np.testing.assert_allclose(left.joint_m @ mirror, right.joint_m, rtol=0, atol=1e-12)
    np.testing.assert_allclose(left.phalanx_m @ mirror, right.phalanx_m, rtol=0, atol=1e-6)
    np.testing.assert_allclose(left.phalanx_radius_m, right.phalanx_radius_m, rtol=0, atol=1e-6)


def test_a_fitted_hand_is_a_hand_to_build(fitted):
    _, hand, folder = fitted
    build(["shape:sphere"], folder / "ball.pack", spheres=20, hand_path=folder / "known.pack")
    again = load_pack(folder / "ball.pack").hand
    np.testing.assert_array_equal(again.phalanx_m, hand.phalanx_m)
    np.testing.assert_array_equal(again.mesh.faces, hand.mesh.faces)
    assert again.about == hand.about


@pytest.fixture
def coarse(monkeypatch):
    """A fit that looks at a fifth of the points and at one bent pose: what it does, in seconds."""
    monkeypatch.setattr("palmar.tools.hand_fit.SPACING_M", 6e-3)
    monkeypatch.setattr("palmar.tools.hand_fit.SWEEP_DEG", (60.0,))
    monkeypatch.setattr("palmar.tools.hand_quality.SPACING_M", 3e-3)
    monkeypatch.setattr("palmar.tools.hand_quality.SWEEP_DEG", (60,))


def write_unrigged(folder, rigged):
    """scan.obj, joints.json and joints.csv of a rigged hand."""
    points = "".join("v {:.7f} {:.7f} {:.7f}\n".format(*vertex) for vertex in rigged["vertices"])
    corners = "".join("f {} {} {}\n".format(*face) for face in rigged["faces"] + 1)
    (folder / "scan.obj").write_text(points + corners)
    places = dict(zip(rigged["names"], rigged["joints"].tolist(), strict=True))
    (folder / "joints.json").write_text(json.dumps(places))
    rows = [f"{name},{x},{y},{z}" for name, (x, y, z) in places.items()]
    (folder / "joints.csv").write_text("\n".join(["name,x,y,z", *rows]))


def test_a_mesh_without_a_skin_is_fitted_to_joints(make_rigged, run, tmp_path, coarse):
    rigged = make_rigged(default_hand(), edge_m=0.006)
    write_unrigged(tmp_path, rigged)
    assert read_joints(tmp_path / "joints.csv") == read_joints(tmp_path / "joints.json")
    code, out, _ = run("fit-hand", "scan.obj", "--joints", "joints.csv", "-o", "scan.pack", "--spheres", "30", "--json")
    answer, hand, true = json.loads(out), load_pack(tmp_path / "scan.pack").hand, default_hand()
    assert code == 0 and answer["hand"]["axes"] == "shape" and answer["hand"]["side"] == "right"
    # The joints are those that were given: their distances are the true ones but for the rounding of the files.
    lengths = [np.linalg.norm(np.diff(of.joint_m, axis=1), axis=2) for of in (hand, true)]
    np.testing.assert_allclose(*lengths, rtol=0, atol=1e-6)
    # 1.0 is the bar for rigged hands. Here the skin weights are guessed, so a seam lies elsewhere, most of all at the
    # ball of the thumb, and a fifth of the points were looked at: 1.8 is what that came to; rounding moves it little.
    assert answer["hand"]["error"]["rest"]["phalanges"]["gap_mm"]["p99"] < 2.0


def test_joints_that_are_missing_are_named(rigged, tmp_path):
    write_unrigged(tmp_path, rigged)
    places = read_joints(tmp_path / "joints.json")
    del places["ring-tip"]
    (tmp_path / "joints.json").write_text(json.dumps(places))
    with pytest.raises(PalmarError, match="ring-tip is missing"):
        fit_hand(tmp_path / "scan.obj", tmp_path / "no.pack", joints_path=tmp_path / "joints.json")
    assert not (tmp_path / "no.pack").exists()


def test_recorded_hands_are_fitted_without_a_hint(request, tmp_path):
    if not request.config.getoption("--all-recordings"):
        pytest.skip("30 s; --all-recordings asks for it")
    if not SHARED.exists():
        pytest.skip("the shared data are not beside this checkout")
    hands = {}
    for side in ("right", "left"):
        path = tmp_path / f"{side}.pack"
        answer = fit_hand(SHARED / "hands" / f"webxr_generic_hand_{side}.glb", path)
        hands[side], error = load_pack(path).hand, answer["hand"]["error"]
        assert answer["hand"]["side"] == side
        for figure in ("protrusion_mm", "gap_mm"):
            # 1.0 is wanted of the phalanges too; round capsules for a flat thumb come to this (docs/hands.md).
            assert error["rest"]["palm"][figure]["p99"] < 1.0 and error["rest"]["phalanges"][figure]["p99"] < 1.3
            assert error["rest"]["phalanges"][figure]["mean"] < 0.35
            assert error["sweep"]["phalanges"][figure]["p99"] < 2.5
    right, left = hands["right"], hands["left"]
    length = [np.linalg.norm(np.diff(hand.joint_m, axis=1), axis=2) for hand in (right, left)]
    # But for the index's knuckle, which the two files have 3.4 mm apart.
    alike = np.ones((5, 3), dtype=bool)
    alike[1, 0] = False
    assert np.abs(length[0] - length[1])[alike[:, :2]].max() < 1e-4
    assert np.abs(right.phalanx_radius_m - left.phalanx_radius_m)[alike].max() < 1e-4


def spoil_names(tree, change):
    for node in tree["nodes"]:
        node["name"] = change(node["name"])


def no_skin(tree):
    del tree["nodes"][-1]["skin"]


def missing_finger(tree):
    spoil_names(tree, lambda name: name.replace("ring", "extra"))


def two_hands(tree):
    spoil_names(tree, lambda name: "left-" + name.replace("ring", "index") if "ring" in name else "right-" + name)


def cyclic(tree):
    tree["nodes"][1]["children"] = [2]
    tree["nodes"][2]["children"] = [1]


def a_body(tree):
    spoil_names(tree, lambda name: {"wrist": "Hips", "thumb-metacarpal": "Spine"}.get(name, f"Leg_{name[-3:]}"))


def test_what_is_no_rigged_hand_is_refused_in_one_line(rigged, write_rigged, tmp_path):
    def refusal(change=lambda tree: None, code="", said="", content=rigged, **options):
        path = write_rigged(tmp_path / "bad.glb", content, change, options.pop("scale", 1.0))
        with pytest.raises(PalmarError) as caught:
            fit_hand(path, tmp_path / "bad.pack", **options)
        assert "\n" not in str(caught.value) and said in str(caught.value) and caught.value.code == code, caught.value
        assert not (tmp_path / "bad.pack").exists()

    refusal(no_skin, "E-RIG", "no mesh with a skin")
    refusal(missing_finger, "E-RIG-JOINT", "ring is missing")
    refusal(two_hands, "E-RIG-HANDS", "two hands")
    refusal(code="E-RIG-UNITS", said="give --units", scale=1000.0)
    refusal(cyclic, "E-RIG", "its own ancestor")
    refusal(a_body, "E-RIG-BODY", "a body")
    spoiled = {**rigged, "weights": rigged["weights"].copy()}
    spoiled["weights"][7] = np.nan
    refusal(code="E-RIG", said="not finite numbers", content=spoiled)
    refusal(code="E-CONF", said="known are m", units="furlong")


def test_any_damage_to_the_file_is_one_line(rigged, write_rigged, tmp_path):
    whole = write_rigged(tmp_path / "whole.glb", rigged).read_bytes()
    rng = np.random.default_rng(3)
    for turn in range(60):
        content = bytearray(whole[: int(rng.integers(0, len(whole)))] if turn % 2 else whole)
        # In the header and the JSON, where damage means something.
        for at in rng.integers(0, max(1, min(len(content), 4000)), 4):
            if content:
                content[at] = int(rng.integers(0, 256))
        path = tmp_path / "damaged.glb"
        path.write_bytes(bytes(content))
        try:
            read_skin(path)
        except PalmarError as error:
            assert "\n" not in str(error)
