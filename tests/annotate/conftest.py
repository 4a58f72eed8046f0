"""What the tests of the annotation server share."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from rpl_data.workspace.workspace import Workspace


@pytest.fixture
def root(tiny_workspace: Workspace, tmp_path: Path) -> Path:
    """A copy of the tiny workspace with its clicks; the pictures stay where they are."""
    shutil.copytree(
        tiny_workspace.root, tmp_path / "ws", ignore=shutil.ignore_patterns("recording", "export", "report")
    )
    (tmp_path / "ws" / "recording").symlink_to(tiny_workspace.recording)
    return tmp_path / "ws"
