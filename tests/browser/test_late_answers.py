"""What the page shows while answers arrive in another order than they were asked for; no server is needed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from playwright.sync_api import Browser, Route

STATIC = Path(__file__).parents[2] / "rpl_data/annotate/static"
POSES = np.array([[0, 0, 0, 0, 0, 0, 0, 1], [1, 0, 0, 0, 0, 0, 0, 1]], np.float32).tobytes()
OPENED = """async () => {
  const { openScene } = await import("/static/image/frames.js");
  const { app } = await import("/static/state/store.js");
  window.app = app;
  app.state = { object: "cup", clicks: [], keypoints: [], skipped: [] };
  await openScene("00", 0);
  window.slow = openScene("slow", 0, { keypoint: 5 });
  return openScene("02", 1, { keypoint: 2 });
}"""


def test_the_scene_that_was_asked_for_last_stays_open(browser: Browser) -> None:
    held: list[Route] = []

    def answer(route: Route) -> None:
        path = route.request.url.removeprefix("http://page")
        if path.startswith("/static/"):
            route.fulfill(path=STATIC / path.removeprefix("/static/"))
        elif path.endswith("/slow"):
            held.append(route)
        elif path.endswith("/poses"):
            route.fulfill(body=POSES)
        else:
            route.fulfill(
                body="{}" if path.startswith("/api/") else "<!doctype html>", content_type="text/html"
            )

    page = browser.new_page()
    page.route("**/*", answer)
    page.goto("http://page/")
    assert page.evaluate(OPENED) is True
    held[0].fulfill(body="{}")
    assert page.evaluate("window.slow") is False
    assert page.evaluate("[app.scene, app.row, app.keypoint]") == ["02", 1, 2]
    page.close()
