"""The page is usable on a slow link, by keyboard alone and with weak eyes, and by nobody else's page."""

from __future__ import annotations

import http.server
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from driving import SHOWN, Server, clicks, on_page, place, saved
from playwright.sync_api import Browser, Page, expect

LEAST_CONTRAST = 4.5
"""WCAG 2.2 AA for text of normal size."""
CONTRASTS = """() => {
    const channel = (c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
    const luminance = ([r, g, b]) => 0.2126 * channel(r) + 0.7152 * channel(g) + 0.0722 * channel(b);
    const parse = (text) => {
        const [r, g, b, a = 1] = text.match(/[\\d.]+/g).map(Number);
        return [r / 255, g / 255, b / 255, a];
    };
    const over = (top, under) => [0, 1, 2].map((i) => top[3] * top[i] + (1 - top[3]) * under[i]);
    const behind = (element) => {
        if (!element) return [1, 1, 1];
        const color = parse(getComputedStyle(element).backgroundColor);
        return color[3] === 1 ? color.slice(0, 3) : over(color, behind(element.parentElement));
    };
    const found = [];
    for (const element of document.querySelectorAll("body *")) {
        const texts = [...element.childNodes].filter((node) => node.nodeType === 3);
        const text = texts.map((node) => node.data.trim()).join("");
        const box = element.getBoundingClientRect();
        if (!text || !box.width || element.closest(":disabled, [hidden], option")) continue;
        const back = behind(element), ink = over(parse(getComputedStyle(element).color), back);
        const [high, low] = [luminance(ink), luminance(back)].sort((a, b) => b - a);
        found.push([text.slice(0, 40), (high + 0.05) / (low + 0.05)]);
    }
    return found;
}"""

TRANSFERRED = "performance.getEntries().reduce((sum, { transferSize }) => sum + (transferSize ?? 0), 0)"
"""Bytes that came over the link, headers included, until now."""


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_all_text_can_be_read(page: Page, theme: str) -> None:
    for _ in range(2):
        place(page, 100.0, 90.0)
        place(page, 130.0, 100.0)
    if page.locator("html").get_attribute("data-theme") != theme:
        page.keyboard.press("t")
    page.evaluate(
        """async () => {
            const { change } = await import("/static/state/store.js");
            change({ alert: { text: "Not saved: the disk is full", again: true } });
        }"""
    )
    expect(page.locator("#alert")).to_be_visible()
    found = page.evaluate(CONTRASTS)
    assert len(found) > 40
    assert not [line for line in found if line[1] < LEAST_CONTRAST]


def test_nothing_is_cut_off_in_a_small_window(page: Page) -> None:
    place(page, 100.0, 90.0)
    outside = page.evaluate(
        """() => [...document.querySelectorAll("header *, #next *, #tools *, #player *, #left .tools *")]
            .filter((e) => e.getClientRects().length)
            .map((e) => [e.id || e.textContent, e.getBoundingClientRect()])
            .filter(([, box]) => box.left < 0 || box.right > innerWidth || box.bottom > innerHeight)
            .map(([name]) => name)"""
    )
    assert outside == []
    assert page.evaluate("document.documentElement.scrollWidth") <= 1280
    page.keyboard.press("?")  # the sheet of keys is longer than the window, and begins at its top
    sheet = page.locator("dialog[open]")
    assert sheet.evaluate("e => [e.scrollTop, e.scrollHeight > e.clientHeight]") == [0, True]


def test_marking_on_a_slow_link(page: Page, server: Server) -> None:
    """100 ms and 250 kB/s: the page is small, and nothing is lost that is done before an answer comes."""
    session = page.context.new_cdp_session(page)
    session.send("Network.enable")
    session.send(
        "Network.emulateNetworkConditions",
        {"offline": False, "latency": 100, "downloadThroughput": 250_000, "uploadThroughput": 250_000},
    )
    session.send("Network.setCacheDisabled", {"cacheDisabled": True})
    page.reload()
    page.wait_for_selector(SHOWN)
    assert 50_000 < page.evaluate(TRANSFERRED) < 500_000, "two seconds of this link at most"
    page.mouse.click(*on_page(page, 100.0, 90.0))
    page.mouse.click(*on_page(page, 130.0, 100.0))
    page.keyboard.press("Control+z")  # before the server has answered any of it
    page.mouse.click(*on_page(page, 140.0, 95.0))
    saved(page)
    assert sorted(k for k, _, _ in clicks(server)) == [0, 2]
    page.keyboard.press("Home")
    for _ in range(4):
        page.keyboard.press(".")
    expect(page.locator("#picture")).to_have_attribute("data-frame", "00/4")


def test_the_keyboard_reaches_everything(page: Page, server: Server) -> None:
    seen, names = set(), []
    for _ in range(80):
        page.keyboard.press("Tab")
        name = page.evaluate("document.activeElement.id || document.activeElement.textContent")
        if name in seen and len(seen) > 20:
            break
        seen.add(name)
        names.append(name)
    buttons = page.evaluate(
        """() => [...document.querySelectorAll("button, select, input, #marks")]
            .filter((e) => e.getClientRects().length && !e.disabled).map((e) => e.id || e.textContent)"""
    )
    assert set(buttons) <= seen, set(buttons) - seen
    page.locator("#keypoints li > button").nth(3).focus()
    page.keyboard.press("Enter")
    expect(page.locator("#keypoints li[aria-current=true] .name")).to_have_text("keypoint 3")
    focused = page.evaluate("document.activeElement.textContent")
    assert "keypoint 3" in focused  # the list was drawn again, the focus is where it was
    page.keyboard.press("g")
    page.keyboard.press("Enter")  # on a button it presses the button, and marks nothing
    page.locator("#marks").focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Enter")
    saved(page)
    assert len(clicks(server)) == 1


@pytest.fixture
def elsewhere(tmp_path: Path) -> Iterator[str]:
    """Another site on this machine."""
    (tmp_path / "index.html").write_text("<!doctype html><title>elsewhere</title>")

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def __init__(self, *arguments: object) -> None:
            super().__init__(*arguments, directory=str(tmp_path))  # type: ignore[arg-type]

        def log_message(self, *arguments: object) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Quiet) as running:
        thread = threading.Thread(target=running.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{running.server_port}/index.html"
        running.shutdown()
        thread.join()


def test_another_site_can_neither_click_nor_look(browser: Browser, server: Server, elsewhere: str) -> None:
    page = browser.new_page()
    page.goto(elsewhere)
    found = page.evaluate(
        """async (url) => {
            const action = { op: "click", keypoint: 0, scene: "00", frame: 0, u_px: 9, v_px: 9 };
            const body = JSON.stringify({ seen: 1, actions: [action] });
            const say = (answer) => `${answer.type} ${answer.status}`;
            const image = new Image();
            const seen = new Promise((resolve) => {
                image.onload = () => resolve("seen");
                image.onerror = () => resolve("refused");
            });
            image.src = `${url}api/scenes/00/frames/0.jpg`;
            return {
                read: await fetch(`${url}api/workspace`).then(say, () => "refused"),
                blind: await fetch(`${url}api/objects/carton`, { method: "POST", mode: "no-cors", body })
                    .then(say, () => "refused"),
                image: await seen,
            };
        }""",
        server.url,
    )
    assert found == {"read": "refused", "blind": "refused", "image": "refused"} or (
        found["blind"] == "opaque 0" and found["read"] == found["image"] == "refused"
    )
    assert clicks(server) == {}
    page.close()
