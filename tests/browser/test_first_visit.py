"""The first visit: a tour that keys lead through, once; then the page by finger."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from driving import SHOWN, ServerHere, clicks, on_page, saved, view
from playwright.sync_api import Browser, CDPSession, Page, expect


@pytest.fixture
def tablet(browser: Browser, server: ServerHere) -> Iterator[Page]:
    """The page on a device with a touch screen that never opened it."""
    context = browser.new_context(viewport={"width": 1280, "height": 720}, has_touch=True)
    page = context.new_page()
    page.goto(server.url)
    page.wait_for_selector(SHOWN)
    yield page
    context.close()


def fingers(session: CDPSession, kind: str, *points: tuple[float, float]) -> None:
    places = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(points)]
    session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": places})


def test_the_tour_and_then_fingers(tablet: Page, server: ServerHere) -> None:
    card = tablet.locator("#tour .card")
    expect(card).to_contain_text("1 of 8")
    for key, count in (("ArrowRight", 2), ("Enter", 3), ("ArrowLeft", 2), ("Enter", 3)):
        tablet.keyboard.press(key)
        expect(card).to_contain_text(f"{count} of 8")
    tablet.keyboard.press("1")  # the page behind it hears nothing
    assert tablet.evaluate("async () => (await import('/static/state/store.js')).app.keypoint") == 0
    tablet.keyboard.press("Escape")
    expect(card).to_have_count(0)
    tablet.reload()
    expect(tablet.locator("#next-text")).to_contain_text("click exactly on")  # then a first visit opens it
    expect(card).to_have_count(0)
    tablet.keyboard.press("F1")  # on request it is there again
    for _ in range(8):
        tablet.keyboard.press("Enter")
    expect(card).to_have_count(0)

    session = tablet.context.new_cdp_session(tablet)
    tablet.touchscreen.tap(*on_page(tablet, 100.0, 90.0))
    saved(tablet)
    fingers(session, "touchStart", on_page(tablet, 200.0, 120.0))
    expect(tablet.locator("#loupe")).to_be_visible()  # after a while
    fingers(session, "touchMove", on_page(tablet, 210.0, 130.0))
    fingers(session, "touchEnd")
    saved(tablet)
    found = [uv for _, uv in sorted(clicks(server).items())]
    np.testing.assert_allclose(found, [(100.0, 90.0), (210.0, 130.0)], atol=0.4)

    before = view(tablet)
    x, y = on_page(tablet, 160.0, 120.0)
    fingers(session, "touchStart", (x - 50, y))
    fingers(session, "touchStart", (x - 50, y), (x + 50, y))
    fingers(session, "touchMove", (x - 100, y + 20), (x + 100, y + 20))
    fingers(session, "touchEnd")
    assert view(tablet)["zoom"] == pytest.approx(2 * before["zoom"], rel=0.01)
    np.testing.assert_allclose(on_page(tablet, 160.0, 120.0), (x, y + 20), atol=1.0)
    fingers(session, "touchStart", (x, y))
    fingers(session, "touchMove", (x + 60, y))
    fingers(session, "touchEnd")
    np.testing.assert_allclose(on_page(tablet, 160.0, 120.0), (x + 60, y + 20), atol=1.0)
    assert len(clicks(server)) == 2, "neither two fingers nor dragging the picture mark anything"
