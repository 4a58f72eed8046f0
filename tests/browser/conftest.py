"""A real Chromium and a real server. A browser that is missing fails these tests, it does not skip them."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from driving import SHOWN, Server, ServerHere, is_ours, toured
from playwright.sync_api import Browser, Page, expect, sync_playwright

from rpl_data.workspace.workspace import Workspace

expect.set_options(timeout=30_000)  # two cores may be busy with other tests
FLAGS = [
    "--no-sandbox", "--enable-unsafe-swiftshader",
    "--disable-background-networking", "--disable-component-update",
]  # fmt: skip
RECIPE = """
name: tiny
scenes: [{path: recording, metres_per_unit: 0.001}]
objects: [{name: carton, keypoints: COUNT}]
label: {rate: all}
"""


def chromium() -> str:
    found = shutil.which("chromium") or shutil.which("chromium-browser")
    assert found, "Chromium is missing: apt-get install chromium"
    return found


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=chromium(), args=FLAGS)
        yield opened
        opened.close()


@pytest.fixture(scope="session")
def unmarked(tiny_workspace: Workspace, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tiny recording, imported but without any click."""
    from rpl_data.pipeline.build import build
    from rpl_data.pipeline.recipe_file import load_recipe

    folder = tmp_path_factory.mktemp("unmarked")
    shutil.copytree(tiny_workspace.recording, folder / "recording")
    count = len(tiny_workspace.load_solution("carton").model.keypoints)
    (folder / "recipe.yaml").write_text(RECIPE.replace("COUNT", str(count)))
    build(load_recipe(folder / "recipe.yaml"), Workspace(folder / "ws"), until="clicks", workers=1)
    return folder


@pytest.fixture
def server(unmarked: Path, tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Server | ServerHere]:
    """A server on a workspace of its own, without clicks; a process that can be killed where asked for.

    Asked for by ``@pytest.mark.parametrize("server", ["process"], indirect=True)``.
    """
    shutil.copytree(unmarked / "ws", tmp_path / "ws")
    kind = Server if getattr(request, "param", None) == "process" else ServerHere
    running = kind(tmp_path / "ws")
    yield running
    running.kill()


@pytest.fixture
def page(browser: Browser, server: Server | ServerHere) -> Iterator[Page]:
    """The page, opened; it may ask for nothing outside the server, nor fail in the console."""
    context = browser.new_context(viewport={"width": 1280, "height": 720}, color_scheme="light")
    context.add_cookies([toured(server.url)])
    opened = context.new_page()
    outside, errors = [], []
    opened.on("request", lambda r: outside.append(r.url) if not is_ours(r.url, server) else None)
    opened.on("pageerror", lambda error: errors.append(str(error)))
    opened.goto(server.url)
    opened.wait_for_selector(SHOWN)
    yield opened
    context.close()
    assert not outside, f"requests to elsewhere: {outside}"
    assert not errors, f"errors in the page: {errors}"
