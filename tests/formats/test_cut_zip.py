"""Members of an archive that lost its end: whole ones as they were, none shortened in silence."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

from rpl_data.formats.containers import cut_zip
from rpl_data.formats.containers.cut_zip import members_of
from rpl_data.types import DataError


@pytest.fixture
def cut(tmp_path: Path) -> Path:
    """Two packed members, and an archive without its list of them."""
    path = tmp_path / "cut.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a", b"a" * 5000)
        archive.writestr("b", np.random.default_rng(0).bytes(3000))
    path.write_bytes(path.read_bytes()[:-40])
    return path


def test_whole_members_of_a_cut_archive_are_read(cut: Path) -> None:
    members = members_of(cut)
    assert members.read["a"]() == b"a" * 5000
    assert members.lost == ("cut.zip was cut off: 2 files of it are whole",)


def test_a_member_that_is_too_large_is_refused_not_shortened(
    cut: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cut_zip, "MOST_BYTES", 4000)
    with pytest.raises(DataError, match="a is larger than 4000 bytes"):
        members_of(cut).read["a"]()


def test_a_member_whose_packed_content_ends_too_early_is_damaged(cut: Path) -> None:
    content = cut_zip._member(cut.read_bytes(), 0)
    assert content is not None
    with pytest.raises(DataError, match="ends too early"):
        cut_zip._unpacked(cut, "a", content[1][:-3], content[2])
