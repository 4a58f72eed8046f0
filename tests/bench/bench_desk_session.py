"""A real recording marked from nothing to an exported dataset, by mouse and keyboard, its actions counted.

Run: RPL_REAL_DATA=... python tests/bench/bench_desk_session.py

Places come from the cube's truth with 1 px of noise; the order of work is what the page's "next step"
says. The baseline is the same work in the paper's program (RapidPoseLabels b9fa6c5), its actions counted from
what its windows ask for. Times of a person are the keystroke-level model's (Card, Moran, Newell 1980).
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from playwright.sync_api import Page, sync_playwright
from rows import record

sys.path.insert(0, str(Path(__file__).parent.parent / "browser"))
from conftest import FLAGS, chromium
from driving import SHOWN, Server, on_page, toured

from rpl_data.geometry import invert, project, transform
from rpl_data.pipeline.build import build
from rpl_data.pipeline.recipe_file import load_recipe
from rpl_data.types import Intrinsics
from rpl_data.workspace.workspace import Workspace

RECIPE = """
name: desk
scenes: [{format: rpl, path: desk}]
objects: [{name: cube, keypoints: 8}]
label: {rate: all}
"""
NOISE_PX = 1.0
SECONDS = {"click": 1.35 + 1.1 + 0.2, "double click": 1.35 + 1.1 + 0.4, "key": 1.35 + 0.28, "command": 15.0}
"""Think, point, press; a command line is some 50 keys. Dragging a polygon counts as two clicks."""
STATE = """async () => {
    const { app, frame } = await import("/static/state/store.js");
    const settled = !app.waiting && !app.result?.checking && app.result?.revision === app.state?.revision;
    const { scene, keypoint, next, fresh } = app;
    return { settled, scene, frame: frame(), keypoint, next, fresh };
}"""


class Cube:
    """Where the corners truly are, and which of them can be seen."""

    def __init__(self, truth: Path, scenes: dict[str, Intrinsics]) -> None:
        data = json.loads(truth.read_text())
        self.points = np.array(data["points_cube"])
        self.poses = {name: np.array(poses) for name, poses in data["camera_from_cube"].items()}
        self.cameras = scenes

    def pixels(self, scene: str, frame: int) -> np.ndarray:
        return project(self.cameras[scene], transform(self.poses[scene][frame], self.points))

    def visible(self, scene: str, frame: int) -> np.ndarray:
        """A corner can be seen when one of its three faces looks at the camera."""
        eye = invert(self.poses[scene][frame])[:3, 3]
        towards = (eye - self.points) * np.sign(self.points)
        return (towards > 0).any(axis=1)


class Person:
    """Acts on the page and counts."""

    def __init__(self, page: Page, cube: Cube) -> None:
        self.page, self.cube, self.count = page, cube, Counter[str]()
        self.random = np.random.default_rng(0)

    def state(self) -> dict[str, object]:
        """The page, once the result of what was done last is there."""
        for _ in range(600):
            state = self.page.evaluate(STATE)
            if state["settled"]:
                return state
            self.page.wait_for_timeout(20)
        raise AssertionError("no result")

    def key(self, key: str) -> None:
        self.count["key"] += 1
        self.page.keyboard.press(key)

    def mark_or_skip(self) -> None:
        """Click on the selected keypoint, or say that it cannot be seen."""
        state = self.state()
        k, scene, frame = state["keypoint"], state["scene"], state["frame"]
        if not self.cube.visible(scene, frame)[k]:
            return self.key("s")
        self.page.wait_for_selector(f'#picture[data-frame="{scene}/{frame}"]')
        at = self.cube.pixels(scene, frame)[k] + self.random.normal(0, NOISE_PX, 2)
        self.count["click"] += 1
        self.page.mouse.click(*on_page(self.page, *at))

    def follow_advice(self) -> None:
        """Do what the next step says until it is to make the labels."""
        for _ in range(60):
            here = self.state()
            step = here["next"]
            if step["action"] == "label":
                return
            place = (step["scene"], step["frame"] or here["frame"], step["keypoint"])
            if place != (here["scene"], here["frame"], here["keypoint"]):
                self.key("g")
                self.arrive(step["scene"], step["keypoint"])
            if step["frame"] is not None:  # it is to look at a click again: it was right
                self.key("]")
            self.mark_or_skip()
        raise AssertionError(f"after 60 actions the page still says: {step['text']}")

    def arrive(self, scene: str, keypoint: int) -> None:
        """Wait until the page shows where it leads: on a busy machine that takes longer than a click."""
        for _ in range(200):
            here = self.state()
            if (here["scene"], here["keypoint"]) == (scene, keypoint):
                return
            self.page.wait_for_timeout(50)
        raise AssertionError(f"G did not lead to scene {scene}, keypoint {keypoint}")

    def make(self, stage: str) -> float:
        """Follow the next steps until the stage is done; seconds."""
        started = time.perf_counter()
        while not (state := self.page.evaluate(STATE))["fresh"].get(stage):
            step = state["next"]
            if step.get("action") == stage or step.get("view"):  # nothing is offered while a job is at work
                self.key("g")
            self.page.wait_for_timeout(500)
            assert time.perf_counter() - started < 400, f"{stage} is not done: {step['text']}"
        return time.perf_counter() - started


def originals_actions(visible: int, scenes: int, hidden: int) -> Counter[str]:
    """The same work in the paper's program.

    Start; Ctrl+O, folder, OK. A scene: Space for a picture, a double click a visible keypoint, Ctrl+Tab
    a hidden one, Ctrl+N. Compute. Then `join.py`: lock the view, draw a polygon (two clicks at least), keep,
    save, close; then `generate.py`. No second look at anything.
    """
    count = Counter({"command": 3})
    count["key"] += 1 + scenes * 2 + hidden + 4
    count["double click"] += visible
    count["click"] += 2 + 1 + 2
    return count


def described(count: Counter[str]) -> str:
    seconds = sum(SECONDS[kind] * n for kind, n in count.items())
    parts = ", ".join(f"{n} {kind}s" for kind, n in count.items())
    return f"{sum(count.values()):3d} actions ({parts}), about {seconds:.0f} s of a person"


def main(data: Path, folder: Path) -> None:
    """Print everything."""
    (folder / "desk.yaml").write_text(RECIPE)
    workspace = Workspace(folder / "ws")
    started = time.perf_counter()
    build(load_recipe(folder / "desk.yaml", root=data), workspace, until="clicks", workers=1)
    imported = time.perf_counter() - started
    names = workspace.scene_names()
    cube = Cube(
        data / "desk" / "truth_cube.json", {name: workspace.load_scene(name).intrinsics for name in names}
    )
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=FLAGS)
        server = Server(workspace.root)
        page = browser.new_page(viewport={"width": 1280, "height": 720})
        page.context.add_cookies([toured(server.url)])
        page.goto(server.url)
        page.wait_for_selector(SHOWN)
        person = Person(page, cube)
        person.count["command"] += 1
        started = time.perf_counter()
        person.follow_advice()
        marked = time.perf_counter() - started
        annotation = workspace.load_annotation("cube")
        labelled, exported = person.make("label"), person.make("export")
        browser.close()
        server.kill()
    errors_px = label_errors_px(workspace, cube)
    theirs = originals_actions(len(annotation.clicks), len(names), len(annotation.skipped))
    print(f"{len(annotation.clicks)} clicks and {len(annotation.skipped)} skips in {len(names)} scenes")
    print(f"machine: read {imported:.1f} s, marked {marked:.1f} s", end=", ")
    print(f"labels {labelled:.1f} s, dataset {exported:.1f} s")
    print("ours     ", described(person.count))
    print("original ", described(theirs), "and its waiting (SLSQP, region growing)")
    print(f"ratio of actions {sum(theirs.values()) / sum(person.count.values()):.2f}")
    ours, originals = sum(person.count.values()), sum(theirs.values())
    record("desk_session", "actions to the labels", ours, "", baseline=("the paper's program", originals))
    record("desk_session", "error of the labels", float(errors_px.mean()), "px")
    frames = sum(len(poses) for poses in cube.poses.values())
    print(f"{len(errors_px)} of {frames} frames labelled; against the truth", end=": ")
    print(f"mean {errors_px.mean():.2f} px, worst frame {errors_px.max():.2f} px")


def label_errors_px(workspace: Workspace, cube: Cube) -> np.ndarray:
    """Mean distance of the labelled keypoints from the true ones, a labelled frame."""
    found = []
    for name in workspace.scene_names():
        for label in workspace.load_labels(name):
            for instance in label.instances:
                gaps = np.linalg.norm(instance.keypoints_px - cube.pixels(name, label.frame), axis=1)
                found.append(np.nanmean(gaps))
    return np.array(found)


if __name__ == "__main__":
    if "RPL_REAL_DATA" not in os.environ:
        print("left out: RPL_REAL_DATA does not say where the desk recording is")
    else:
        with tempfile.TemporaryDirectory() as made:
            main(Path(os.environ["RPL_REAL_DATA"]), Path(made))
