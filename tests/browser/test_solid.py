"""The 3D view in a real browser: loaded when it is opened, and following every click."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from driving import Server, place, saved
from playwright.sync_api import Page, expect

from rpl_data.geometry import invert, transform
from rpl_data.workspace.workspace import Workspace


@pytest.fixture
def clicked(server: Server, tiny_workspace: Workspace) -> Server:
    """The server, its workspace with the clicks of the tiny one."""
    events = [
        {"op": "click", **{key: value for key, value in vars(click).items() if key != "object"}}
        for click in tiny_workspace.load_annotation("carton").clicks
    ]
    Workspace(server.workspace).append_events("carton", events)
    return server


def open_solid(page: Page) -> None:
    page.keyboard.press("v")
    page.wait_for_selector("#plot[data-drawn]")


def traces(page: Page) -> list[dict[str, Any]]:
    """Name, colour and points (mm) of what is drawn."""
    return page.evaluate(
        """() => document.getElementById("plot").data.map(({ name, x, y, z, text, marker }) => (
            { name, text, color: marker?.color, points: x.map((_, i) => [x[i], y[i], z[i]]) }))"""
    )


def named(page: Page, name: str | None) -> dict[str, Any]:
    return next(trace for trace in traces(page) if trace.get("name") == name)


def test_plotly_is_loaded_when_the_view_is_first_opened(page: Page) -> None:
    assert page.evaluate("window.Plotly") is None
    page.keyboard.press("v")
    expect(page.locator("#plot-empty")).to_contain_text("mark a keypoint")
    page.keyboard.press("v")
    page.keyboard.press("v")
    place(page, 160.0, 120.0)
    open_solid(page)
    assert len(named(page, "scene 00")["points"]) > 300


def test_it_shows_scenes_in_the_object_frame_and_follows_a_click(
    clicked: Server, page: Page, tiny_workspace: Workspace
) -> None:
    solution = tiny_workspace.load_solution("carton")
    expect(page.locator("#scenes .good")).to_have_count(3)
    open_solid(page)
    page.wait_for_function(
        "() => document.getElementById('plot').data.filter((t) => /^scene/.test(t.name)).length === 3"
    )
    scenes = [named(page, f"scene {name}") for name in ("00", "01", "02")]
    assert len({scene["color"] for scene in scenes}) == 3
    extent_m = np.ptp(solution.model.points_object[solution.model.known], axis=0).max()
    for scene in scenes:  # around the origin of the object frame, not of the scene's
        assert np.abs(scene["points"]).max() < 1e3 * extent_m
    keypoints = next(trace for trace in traces(page) if trace.get("text"))
    expected = 1e3 * solution.model.points_object[solution.model.known]
    np.testing.assert_allclose(keypoints["points"], expected, atol=0.05)
    page.keyboard.press("0")
    page.get_by_label("camera path").check()
    page.get_by_label("distances").check()
    page.wait_for_function(
        "() => document.getElementById('plot').data.filter((t) => /^camera/.test(t.name)).length === 3"
    )
    path = tiny_workspace.load_trajectory(tiny_workspace.load_scene("01")).scene_from_camera[:, :3, 3]
    in_object = 1e3 * transform(invert(solution.scene_from_object["01"]), path)
    np.testing.assert_allclose(named(page, "camera 01")["points"], in_object, atol=0.1)
    said = float(named(page, "distance to keypoint 1")["text"][1])
    assert said == pytest.approx(np.linalg.norm(expected[1] - expected[0]), abs=0.1)
    drawn = page.locator("#plot").get_attribute("data-drawn")
    page.keyboard.press("Control+z")
    saved(page)
    page.wait_for_function(f"() => document.getElementById('plot').dataset.drawn > {drawn}")
    page.wait_for_function(
        "(before) => document.getElementById('plot').data.find((t) => t.text).x[0] !== before",
        arg=keypoints["points"][0][0],
    )


def test_a_crop_box_is_shown_at_once_and_saved_when_the_slider_rests(clicked: Server, page: Page) -> None:
    expect(page.locator("#scenes .good")).to_have_count(3)
    open_solid(page)
    page.locator("#crop summary").click()
    page.locator("#crop-add").click()
    saved(page)
    whole = np.concatenate([named(page, f"scene {name}")["points"] for name in ("00", "01", "02")])
    slider = page.get_by_label("crop box, y to").bounding_box()
    assert slider is not None
    middle = slider["y"] + slider["height"] / 2
    share = page.get_by_label("crop box, y to").evaluate("(s) => (s.value - s.min) / (s.max - s.min)")
    page.mouse.move(slider["x"] + 8 + share * (slider["width"] - 16), middle)
    page.mouse.down()
    page.mouse.move(slider["x"] + 0.55 * slider["width"], middle, steps=5)
    with page.expect_response(lambda answer: answer.request.method == "POST"):
        page.mouse.up()
    saved(page)
    crop = Workspace(clicked.workspace).load_annotation("carton").crop_m
    assert crop is not None
    events = Workspace(clicked.workspace).load_events("carton")
    assert sum(event["op"] == "crop" for event in events) == 2, "a drag is one action"
    points = np.concatenate([named(page, f"scene {name}")["points"] for name in ("00", "01", "02")])
    low, high = 1e3 * np.array(crop)
    assert (points >= low).all() and (points <= high).all()
    inside = ((whole > low) & (whole < high)).all(axis=1)
    assert len(points) == inside.sum() < len(whole)


def test_names_are_readable_in_light_and_dark(clicked: Server, page: Page) -> None:
    open_solid(page)
    shown = "(({ layout }) => [layout.font.color, layout.paper_bgcolor])(document.getElementById('plot'))"
    light = page.evaluate(shown)
    page.keyboard.press("t")
    page.wait_for_function(f"(before) => {shown}[1] !== before", arg=light[1])
    dark = page.evaluate(shown)
    assert contrast(*light) > 7 and contrast(*dark) > 7


def contrast(one: str, other: str) -> float:
    """WCAG's contrast ratio of two colours #rrggbb."""
    bright, dark = sorted((luminance(one), luminance(other)), reverse=True)
    return (bright + 0.05) / (dark + 0.05)


def luminance(color: str) -> float:
    values = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.where(values <= 0.03928, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])
