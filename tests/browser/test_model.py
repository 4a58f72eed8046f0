"""Known models in a real browser: picked on a mesh, loaded from a file, and a grasp marked by two clicks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from driving import Server, in_plot, on_page, place, saved
from playwright.sync_api import Page, expect

from rpl_data.formats.models.sparse_model import write_sparse_model
from rpl_data.meshes import save_mesh
from rpl_data.types import Mesh
from rpl_data.workspace.workspace import Workspace

PYRAMID = Mesh(
    np.array([[0.0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0], [0.05, 0.05, -0.12]]),
    np.array([[0, 2, 1], [0, 3, 2], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]),
)


HEAR_HOVERS = """() => document.getElementById("plot").on("plotly_hover", ({ points: [{ x, y, z }] }) => {
    window.hovered = [x, y, z];
})"""
IS_HOVERED = "(point) => window.hovered?.every((value, i) => Math.abs(value - point[i]) < 0.01)"


def choose(page: Page, entry: str, path: Path) -> None:
    """Load a file by an entry of the menu of files."""
    page.keyboard.press("o")
    with page.expect_file_chooser() as chooser:
        page.locator("dialog").get_by_text(entry, exact=True).click()
    chooser.value.set_files(path)


def test_keypoints_are_picked_on_a_mesh(page: Page, server: Server, tmp_path: Path) -> None:
    save_mesh(tmp_path / "pyramid.ply", PYRAMID)
    choose(page, "Load a known model", tmp_path / "pyramid.ply")
    page.keyboard.press("Enter")  # its unit is the metre
    page.wait_for_selector("#plot[data-drawn]")
    expect(page.locator("#model-panel")).to_contain_text("0 picked")
    page.evaluate(HEAR_HOVERS)
    chosen = [4, 1, 2]  # corners that the first view sees
    for count, corner in enumerate(chosen, start=1):
        x, y = in_plot(page, tuple(1e3 * PYRAMID.vertices[corner]))
        middle = in_plot(page, (50.0, 50.0, -40.0))
        aim = np.array([x, y]) + 3 * (np.array(middle) - [x, y]) / np.hypot(middle[0] - x, middle[1] - y)
        page.mouse.move(*aim, steps=4)
        page.wait_for_function(IS_HOVERED, arg=list(1e3 * PYRAMID.vertices[corner]))  # what a click picks
        page.mouse.click(*aim)
        expect(page.locator("#model-panel")).to_contain_text(f"{count} picked", timeout=60_000)
    saved(page)
    known = Workspace(server.workspace).load_annotation("carton").known_points
    assert known is not None
    np.testing.assert_allclose(np.array(known[:3], dtype=float), PYRAMID.vertices[chosen], atol=1e-6)
    page.locator("#pick").click()
    expect(page.locator("#pick")).to_have_text("Pick keypoints on the mesh")


def test_three_clicks_place_a_loaded_model(
    page: Page, server: Server, tmp_path: Path, tiny_workspace: Workspace
) -> None:
    truth = Workspace(tiny_workspace.truth)
    write_sparse_model(tmp_path / "sparse_model.txt", truth.load_solution("carton").model.points_object)
    choose(page, "Load a known model", tmp_path / "sparse_model.txt")
    saved(page)
    frame = int(page.evaluate("async () => (await import('/static/state/store.js')).frame()"))
    label = next(label for label in truth.load_labels("00") if label.frame == frame).instances[0]
    for keypoint in np.flatnonzero(label.visibility == 2)[:3]:
        page.locator("#keypoints li").nth(int(keypoint)).locator("button").first.click()
        place(page, *map(float, label.keypoints_px[keypoint]))
    expect(page.locator("#scene-progress")).to_contain_text("1 of 3")


def test_a_grasp_is_marked_by_two_clicks(page: Page, server: Server, tiny_workspace: Workspace) -> None:
    page.keyboard.press("w")
    expect(page.locator("#next-text")).to_contain_text("grasp: click")
    page.mouse.click(*on_page(page, 150.0, 120.0))
    expect(page.locator("#next-text")).to_contain_text("toward where")
    page.mouse.click(*on_page(page, 180.0, 118.0))
    saved(page)
    annotation = Workspace(server.workspace).load_annotation("carton")
    assert annotation.grasp is not None and annotation.clicks == ()
    found = [
        annotation.grasp.u_px,
        annotation.grasp.v_px,
        annotation.grasp.toward_u_px,
        annotation.grasp.toward_v_px,
    ]
    np.testing.assert_allclose(found, [150, 120, 180, 118], atol=0.25)
    place(page, 100.0, 90.0)  # clicks are for keypoints again
    assert len(Workspace(server.workspace).load_annotation("carton").clicks) == 1
