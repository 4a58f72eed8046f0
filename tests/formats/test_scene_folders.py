"""Which folders hold a scene: two of one name are said, none is said."""

from __future__ import annotations

from pathlib import Path

import pytest

from rpl_data.formats.recordings.scene_folders import chosen_scenes
from rpl_data.types import DataError


def is_scene(folder: Path) -> bool:
    return (folder / "mark").exists()


def test_a_scene_within_a_scene_of_its_name_is_not_lost_in_silence(tmp_path: Path) -> None:
    inner = tmp_path / "desk" / "desk"
    inner.mkdir(parents=True)
    (inner / "mark").touch()
    assert chosen_scenes(tmp_path / "desk", is_scene, None, lacks="a mark") == {"desk": inner}
    (tmp_path / "desk" / "mark").touch()
    with pytest.raises(DataError, match="two scenes are called desk"):
        chosen_scenes(tmp_path / "desk", is_scene, None, lacks="a mark")
    with pytest.raises(DataError, match="has no a mark, and neither has any folder in it"):
        chosen_scenes(tmp_path / "nowhere", is_scene, None, lacks="a mark")
