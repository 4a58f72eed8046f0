"""Recordings that lie in object stores, and exports that go there."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

from rpl_data.pipeline.ledger import Advance, Outcome
from rpl_data.pipeline.object_store import copy_name, fetch, upload, url_of, without_secrets
from rpl_data.pipeline.progress import Progress, Tell
from rpl_data.pipeline.recipe import Recipe
from rpl_data.wording import counted
from rpl_data.workspace.workspace import Workspace


def copy_of(workspace: Workspace, url: str) -> Path:
    """Where the copy of a recording is, or will be; absolute, as paths of recipe files are."""
    return (workspace.copies / copy_name(url)).absolute()


def fetch_recordings(recipe: Recipe, workspace: Workspace, tell: Tell) -> None:
    """Bring the copies of the recipe's recordings up to date; their stores are asked what has changed.

    Raises:
        DataError: a store cannot be reached.
    """
    for source in recipe.scenes:
        fetched(source.path, workspace, tell)


def fetched(path: Path, workspace: Workspace, tell: Tell) -> Path:
    """The copy of a recording, brought up to date; a recording of this machine itself."""
    url = url_of(path)
    if url is None:
        return path
    copy = copy_of(workspace, url)
    copied = fetch(url, copy, _advance(tell, url))
    said = (f"{counted(copied, 'file')} copied",) if copied else ()
    tell(
        Progress("import", without_secrets(url), "ran" if copied else "kept", outcome=Outcome(messages=said))
    )
    return copy


def _advance(tell: Tell, url: str) -> Advance:
    return lambda done, total: tell(Progress("import", without_secrets(url), "runs", done, total))


def upload_exports(workspace: Workspace, folders: Sequence[Path], url: str, advance: Advance) -> Outcome:
    """Copy exports to an object store, one folder for each; only what has changed.

    Raises:
        DataError: the store cannot be reached or written.
    """
    lines = []
    for folder in folders:
        there = f"{url.rstrip('/')}/{folder.relative_to(workspace.root / 'export').as_posix()}"
        name = hashlib.sha256(there.encode()).hexdigest()[:12]
        copied = upload(folder, there, workspace.upload_log(name), advance)
        lines.append(f"{without_secrets(there)}: {counted(copied, 'file')} copied")
    return Outcome(messages=tuple(lines))
