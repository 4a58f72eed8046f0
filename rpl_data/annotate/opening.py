"""Other workspaces and recordings, opened from the page: only below the folder that its server may open."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from rpl_data.annotate.work import Tell
from rpl_data.types import DataError
from rpl_data.workspace.workspace import Workspace

MOST_LOOKED_AT = 2000
MOST_LISTED = 200
DEEPEST = 3
"""Levels of folders below the allowed one that are searched for workspaces."""


@dataclass(frozen=True)
class Opening:
    """What the page may open.

    Attributes:
        folder: the only folder below which anything is opened; None where nothing is.
        serve: serves a workspace, and returns the port at which its page is.
        take_in: (recording, workspace, object, keypoints, tell) reads a recording into a new workspace;
            object and keypoints may be empty.
    """

    folder: Path | None
    serve: Callable[[Path], int]
    take_in: Callable[[Path, Path, str, str, Tell], list[str]]

    def allowed(self, text: str) -> Path:
        """The path that was asked for, links resolved; relative ones start at the folder.

        Raises:
            DataError: it is not below the folder, whether it exists or not.
        """
        if self.folder is None:
            raise DataError(
                "this page opens nothing else, since it is served to other machines; start `rpl annotate` "
                "with --folder DIR to let it open what is below that folder"
            )
        folder = self.folder.resolve()
        try:
            path = (folder / text).resolve()
        except (OSError, RuntimeError, ValueError) as error:
            raise DataError(f"{text[:200]!r} is no path; give a folder below {folder}") from error
        if not path.is_relative_to(folder):
            raise DataError(
                f"only what is below {folder} can be opened from this page; start `rpl annotate` with "
                "--folder DIR to allow another folder"
            )
        return path

    def new_workspace(self, recording: Path) -> Path:
        """Where the workspace of a recording is made."""
        assert self.folder is not None
        return self.folder.resolve() / f"{recording.stem}_workspace"

    def workspaces(self) -> list[Path]:
        """The workspaces below the folder, in order."""
        if self.folder is None:
            return []
        found = (path for path in _folders(self.folder.resolve()) if is_workspace(path))
        return sorted(path for _, path in zip(range(MOST_LISTED), found, strict=False))


def is_workspace(path: Path) -> bool:
    """Whether a folder is a workspace, as a build or an import makes it."""
    place = Workspace(path)
    return place.recipe_file.is_file() and (path / "scenes").is_dir()


def _folders(top: Path) -> Iterator[Path]:
    """The folder and those below it, without links and hidden ones; what lies in a workspace is left out."""
    for looked_at, (place, names, _) in enumerate(os.walk(top, followlinks=False)):
        if looked_at >= MOST_LOOKED_AT:
            return
        path = Path(place)
        yield path
        deep = len(path.relative_to(top).parts) >= DEEPEST
        names[:] = [] if deep or is_workspace(path) else sorted(n for n in names if not n.startswith("."))
