"""What `palmar chart` is drawn of: which trace goes to which object, and what is made where there is none."""

from dataclasses import replace

import numpy as np
import pytest
from made_trace import make_trace

from palmar.chart_inputs import find_scenes
from palmar.errors import PalmarError
from palmar.model import AssetPack, SphereTree, load_pack, save_pack
from palmar.records import read_trace, write_trace
from palmar.tools.hand_file import default_hand
from palmar.tools.sphere_tree import bounds_over
from palmar.traces.fingers import IN_USE


def find(files, tmp_path, shapes=(), grasps=1, fingers=False):
    told = []
    made = tmp_path / "made"
    found = find_scenes(
        files,
        shapes,
        spheres=[60, 30],
        grasps=grasps,
        fingers=fingers,
        made=made,
        progress=lambda *now: told.append(now),
    )
    return found, told


def ball_pack(path, *names):
    ball = np.array([[0.0, 0.06, -0.045, 0.03]])
    tree = SphereTree([ball], [bounds_over(ball)], ball[:, :3], np.zeros((0, 3), dtype=np.int32), {"levels": [{}]})
    save_pack(path, AssetPack(default_hand(), dict.fromkeys(names, tree), {}))
    return path


def trace_of(path, name):
    trace = make_trace(20)
    write_trace(path, replace(trace, header=trace.header | ({"object": name} if name else {})))
    return path


def test_a_shape_gets_its_levels_a_grasp_and_grasps_with_a_part_of_the_hand(tmp_path):
    scenes, told = find([], tmp_path, shapes=["sphere"], fingers=True)
    assert [scene.in_use for scene in scenes] == ["", *IN_USE]
    assert told == [("making sphere", 0.0)]
    assert {scene.object for scene in scenes} == {"sphere"} and len({scene.trace for scene in scenes}) == len(scenes)
    assert [len(level) for level in load_pack(scenes[0].pack).objects["sphere"].levels] == [30, 60]
    whole = read_trace(scenes[0].trace)
    assert whole.header["object"] == "sphere"
    one = next(read_trace(scene.trace) for scene in scenes if scene.in_use == "one finger")
    assert np.ptp(one.flexion_rad[:, 2:], axis=0).max() == 0 < np.ptp(whole.flexion_rad[:, 2:], axis=0).max()
    # What has been made is taken up again.
    times = {path: path.stat().st_mtime_ns for path in (scenes[0].pack, scenes[0].trace)}
    assert find([], tmp_path, shapes=["sphere"])[0] == scenes[:1]
    assert times == {path: path.stat().st_mtime_ns for path in times}


def test_a_trace_goes_to_the_object_that_it_names_or_to_the_only_one(tmp_path):
    both, ball = ball_pack(tmp_path / "both.pack", "cup", "can"), ball_pack(tmp_path / "ball.pack", "ball")
    named, bare = trace_of(tmp_path / "named.mcap", "can"), trace_of(tmp_path / "bare.mcap", "")
    (scene,), _ = find([both, ball, named], tmp_path, grasps=0)
    assert (scene.pack, scene.object, scene.trace) == (both, "can", named)
    (scene,), _ = find([ball, bare], tmp_path, grasps=0)
    assert (scene.pack, scene.object, scene.name) == (ball, "ball", "ball bare")
    with pytest.raises(PalmarError, match=r"E-OBJECT .*bare.mcap: names no object; the packs hold can, cup: "):
        find([both, bare], tmp_path, grasps=0)
    other = trace_of(tmp_path / "other.mcap", "jug")
    with pytest.raises(PalmarError, match=r"E-OBJECT .*other.mcap: names object 'jug'; the packs hold can, cup: "):
        find([both, other], tmp_path, grasps=0)
    with pytest.raises(PalmarError, match="E-USAGE PACK: nothing to replay"):
        find([both], tmp_path, grasps=0)
