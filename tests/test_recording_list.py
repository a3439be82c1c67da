"""The list of recorded data outside of the project against the files beside it and the tests that it names."""

from pathlib import Path

import pytest

from palmar.files import sha256_of
from palmar.traces.device import DEVICES, HANDS

from .recordings import SHARED, TOP, listed

GROUPS = listed()


def test_each_group_says_where_it_is_from_how_it_is_read_and_who_uses_it():
    for name, about in GROUPS.items():
        assert set(about) == {"what", "origin", "licence", "format", "recordings", "used_by", "files"}, name
        assert about["format"] in DEVICES or about["format"] in HANDS, name
        assert all(len(sha256) == 64 for sha256 in about["files"].values()), name
        for path in about["used_by"]:
            assert (TOP / path).is_file(), f"{name}: {path}"


@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared recordings are not beside the project")
def test_every_recording_beside_the_project_is_in_the_list_with_its_hash():
    files = {name: sha256 for about in GROUPS.values() for name, sha256 in about["files"].items()}
    for name, sha256 in files.items():
        assert sha256_of(SHARED / name) == sha256, name
    there = {path.relative_to(SHARED).as_posix() for path in Path(SHARED / "traces").rglob("*.csv")}
    assert there <= set(files)
