"""Fixtures several test files share."""

from __future__ import annotations

import contextlib
import gc
import io
import json
import os
import resource
import shutil
import signal
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import pytest
from array_checks import quick_checks

quick_checks()  # before anything of rpl_data is imported

from built_once import made_once, moved_copy, plain_recipe  # noqa: E402

from rpl_data.workspace.workspace import Workspace  # noqa: E402

TINY = Path(__file__).parent / "tiny.yaml"
NEEDS_NONE = "test_doctor.py"
"""A file of tests that takes longer than building the tiny workspace, which it does not need."""
gc.set_threshold(100_000, 20, 20)  # a collection walks all modules, and the tests import many


def pytest_collection_finish() -> None:
    """What was imported stays; the collector need not look at it again."""
    gc.freeze()


def pytest_collection_modifyitems(items: list[pytest.Item], config: pytest.Config) -> None:
    """Tests on real recordings run where RPL_REAL_DATA points at them; elsewhere they are deselected.

    Of two processes, one builds the tiny workspace while the other takes a file that needs none.
    """
    first = items[0].path if items else None
    items.sort(key=lambda item: 0 if item.path == first else 1 if item.path.name == NEEDS_NONE else 2)
    if "RPL_REAL_DATA" in os.environ:
        return
    real = [item for item in items if "real_data" in getattr(item, "fixturenames", ())]
    config.hook.pytest_deselected(items=real)
    items[:] = [item for item in items if item not in real]


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder with the real recordings: desk/, kitchen/, ycb/."""
    return Path(os.environ["RPL_REAL_DATA"])


@contextmanager
def _full_disk(free_bytes: int) -> Iterator[None]:
    """The kernel refuses to let a file grow beyond this many bytes, as on a full disk."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    previous = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # else the kernel ends the process
    resource.setrlimit(resource.RLIMIT_FSIZE, (free_bytes, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, previous)


@pytest.fixture
def full_disk() -> Callable[[int], AbstractContextManager[None]]:
    """`with full_disk(free_bytes):` no file grows beyond that."""
    return _full_disk


@pytest.fixture(scope="session")
def tiny_workspace(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    """A small synthetic recording, built to its report once a session; look, but do not change it."""

    def make(folder: Path) -> None:
        from rpl_data.pipeline.build import build
        from rpl_data.pipeline.recipe_file import load_recipe

        build(load_recipe(TINY), Workspace(folder), workers=1)

    built = made_once(tmp_path_factory, "tiny", make)
    # Commands lock a workspace, so each process has one of its own.
    return Workspace(moved_copy(built, tmp_path_factory.mktemp("tiny") / "workspace"))


@pytest.fixture(scope="session")
def plain_build(tiny_workspace: Workspace, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder whose `recording` is built into its `ws` by its `recipe.yaml`, one command after the other.

    It is the tiny recording, as if it were anybody's. `said.json` has what each command printed. Only
    for `moved_copy`.
    """

    def make(folder: Path) -> None:
        from rpl_data.cli.main import main

        shutil.copytree(tiny_workspace.recording, folder / "recording")
        recipe, said = plain_recipe(folder), {}
        for command in ("import", "solve", "surface", "segment", "label", "export", "report"):
            with contextlib.redirect_stdout(io.StringIO()) as printed:
                first = [command, str(recipe)] if command == "import" else [command]
                assert main([*first, "--workspace", str(folder / "ws")]) == 0
            said[command] = printed.getvalue()
        (folder / "said.json").write_text(json.dumps(said))

    return made_once(tmp_path_factory, "plain", make)


@pytest.fixture(scope="session")
def known_model(tiny_workspace: Workspace, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As `plain_build`, but until the dense model only, and without any click in scene 02.

    Those clicks are in `later.csv`. Only for `moved_copy`.
    """

    def make(folder: Path) -> None:
        from rpl_data.pipeline.build import build
        from rpl_data.pipeline.recipe_file import load_recipe

        shutil.copytree(tiny_workspace.recording, folder / "recording")
        clicks = folder / "recording" / "clicks.csv"
        heading, *rows = clicks.read_text().splitlines(keepends=True)
        clicks.write_text(heading + "".join(row for row in rows if ",02," not in row))
        (folder / "later.csv").write_text(heading + "".join(row for row in rows if ",02," in row))
        build(load_recipe(plain_recipe(folder)), Workspace(folder / "ws"), until="segment", workers=1)

    return made_once(tmp_path_factory, "known", make)
