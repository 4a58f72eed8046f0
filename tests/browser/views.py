"""Every view of the page, the report and the documentation, light and dark, in two sizes of window.

    python tests/browser/views.py OUT WORKSPACE [SITE]

Not a test: the pictures are to be looked at. WORKSPACE is a built one, which is copied; SITE is what
`make docs` builds.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from conftest import FLAGS, chromium
from driving import SHOWN, Server, on_page, saved, toured, wait_until
from playwright.sync_api import Browser, Page, expect, sync_playwright

from rpl_data.workspace.workspace import Workspace

SIZES = ((1280, 720), (1920, 1080))
PATIENT_MS = 180_000
SETTLED = """({ app }) => {
    return app.next && !app.waiting && app.result?.revision === app.state?.revision && !app.result.checking;
}"""


def main(out: Path, workspace: Path, site: Path | None = None) -> None:
    """Write OUT/<view>_<theme>_<width>.png."""
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        copy = Path(folder) / workspace.name
        shutil.copytree(workspace, copy, symlinks=True)
        server = Server(copy)
        browser = playwright.chromium.launch(executable_path=chromium(), args=FLAGS)
        try:
            for size in SIZES:
                for theme in ("light", "dark"):
                    shoot_all(browser, server, out, size, theme, site)
        finally:
            browser.close()
            server.kill()


def shoot_all(
    browser: Browser, server: Server, out: Path, size: tuple[int, int], theme: str, site: Path | None
) -> None:
    """All views in one theme and size."""
    context = browser.new_context(viewport={"width": size[0], "height": size[1]}, color_scheme=theme)  # type: ignore[arg-type]
    page = context.new_page()

    def shot(name: str) -> None:
        page.wait_for_timeout(700)  # pictures and 3D that are still on their way
        page.screenshot(path=out / f"{name}_{theme}_{size[0]}.png")

    page.goto(f"{server.url}#scene={scene_of(server.workspace)}")
    page.wait_for_selector(SHOWN)
    tour(page, shot)
    context.add_cookies([toured(server.url)])
    wait_until(page, SETTLED, timeout_ms=PATIENT_MS)
    for view in (marking, solid, sheet, dialogs):
        view(page, shot)
    page.goto((server.workspace / "report" / "index.html").as_uri())
    page.wait_for_timeout(1500)
    shot("report")
    page.screenshot(path=out / f"report_whole_{theme}_{size[0]}.png", full_page=True)
    if site:
        page.goto((site / "index.html").as_uri())
        shot("docs")
    context.close()


def scene_of(root: Path) -> str:
    """The first scene in which the first object was clicked."""
    workspace = Workspace(root)
    return min(click.scene for click in workspace.load_annotation(workspace.object_names()[0]).clicks)


def tour(page: Page, shot: Callable[[str], None]) -> None:
    """The first card, one in the middle, and all others passed."""
    cards = page.locator("#tour .card")
    expect(cards).to_be_visible()
    shot("tour_1")
    for _ in range(4):
        page.keyboard.press("Enter")
    shot("tour_5")
    page.keyboard.press("Escape")


def marking(page: Page, shot: Callable[[str], None]) -> None:
    """The scene view: as it opens, with names and mask, with the loupe, with a grasp begun and marked."""
    shot("mark")
    page.keyboard.press("]")
    page.keyboard.press("n")
    page.keyboard.press("l")
    u, v = clicked(page)
    page.mouse.move(*on_page(page, u, v))
    shot("mark_names_mask")
    page.keyboard.press("n")
    page.keyboard.press("l")
    page.keyboard.press("w")
    shot("grasp")
    page.mouse.click(*on_page(page, u, v))
    page.mouse.click(*on_page(page, u + 40, v))
    saved(page)
    shot("grasp_marked")
    page.keyboard.press("Control+z")
    saved(page)


def clicked(page: Page) -> tuple[float, float]:
    """A pixel with a click of the scene that is open."""
    u, v = page.evaluate(
        """async () => {
            const { app, clicksIn } = await import("/static/state/store.js");
            const click = clicksIn(app.scene)[0];
            return [click.u_px, click.v_px];
        }"""
    )
    return u, v


def solid(page: Page, shot: Callable[[str], None]) -> None:
    """The 3D view, with camera path and distances."""
    page.keyboard.press("v")
    page.wait_for_selector("#plot[data-drawn]", timeout=PATIENT_MS)
    page.wait_for_timeout(2000)
    shot("solid")
    page.get_by_label("camera path").check()
    page.get_by_label("distances").check()
    page.wait_for_timeout(2000)
    shot("solid_path_distances")
    page.get_by_label("camera path").uncheck()
    page.get_by_label("distances").uncheck()


def sheet(page: Page, shot: Callable[[str], None]) -> None:
    """The contact sheet."""
    page.locator("#views button[data-view=labels]").click()
    page.wait_for_function(
        "() => { const all = [...document.querySelectorAll('#sheet img')].slice(0, 8);"
        " return all.length === 8 && all.every((i) => i.naturalWidth); }",
        timeout=PATIENT_MS,
    )
    shot("labels")
    page.locator("#views button[data-view=mark]").click()


def dialogs(page: Page, shot: Callable[[str], None]) -> None:
    """Open, files, keys, and the question before a scene is reset."""
    for key, name in (("Shift+O", "open"), ("o", "files"), ("?", "keys"), ("a", "add")):
        page.keyboard.press(key)
        expect(page.locator("dialog[open]")).to_be_visible()
        shot(f"dialog_{name}")
        page.keyboard.press("Escape")
    page.get_by_role("button", name="reset").first.click()
    expect(page.locator("dialog[open]")).to_be_visible()
    shot("dialog_reset")
    page.keyboard.press("Escape")


if __name__ == "__main__":
    if len(sys.argv) not in (3, 4):
        sys.exit(__doc__)
    main(*map(Path, sys.argv[1:]))
