"""Changed copies of a small mesh in each format: refused with one line, or built to what their bytes say.

`python tests/tools/hostile_figures.py` tries every truncation and many more.
"""

import random

import pytest
from hostile_figures import SMALL, changed, outcome

from palmar.errors import BadMesh
from palmar.tools.mesh import read_mesh


@pytest.mark.parametrize("extension", SMALL)
def test_a_changed_mesh_is_refused_or_built_as_it_now_reads(extension, tmp_path):
    rng = random.Random(extension)
    for _ in range(40):
        raw = changed(SMALL[extension], rng)
        said = outcome(raw, extension, tmp_path)
        assert said == "built" or said.startswith("E-MESH"), (said, raw)
        for path in tmp_path.iterdir():
            path.unlink()


@pytest.mark.parametrize("extension", ["obj", "off", "ply"])
def test_a_number_torn_in_two_is_no_coordinate(extension, tmp_path):
    raw = SMALL[extension]
    start = next(k for k in range(len(raw)) if raw[k : k + 5] == b"0.030")
    path = tmp_path / f"torn.{extension}"
    path.write_bytes(raw[: start + 5] + b" " + raw[start + 5 :])
    with pytest.raises(BadMesh, match=r"E-MESH-(FORMAT|HEADER)"):
        read_mesh(path)


def test_a_vertex_with_a_weight_of_one_or_a_colour_is_read(tmp_path):
    raw = SMALL["obj"].decode().splitlines()
    for extra in (" 1.0", " 0.5 0.5 0.5"):
        path = tmp_path / "more.obj"
        path.write_text("\n".join(row + extra if row.startswith("v ") else row for row in raw))
        assert len(read_mesh(path).faces) == 12
