"""The annotation page: click to result, first view, change of frame, memory over 1,000 actions.

Run: python tests/bench/bench_annotate.py [--keep FOLDER] [--actions 1000]
Chromium and the server are real. FOLDER keeps the synthetic recording for the next time (about 2 minutes).
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as `rpl` does, before NumPy is loaded

import numpy as np
from playwright.sync_api import Browser, CDPSession, Page, sync_playwright

sys.path.insert(0, str(Path(__file__).parent.parent / "browser"))
from conftest import FLAGS, chromium
from driving import SHOWN, Server, on_page, toured
from rows import record, shared

from rpl_data.annotate.live import Lifter, solve_live
from rpl_data.annotate.stores.scenes import SceneStore
from rpl_data.cli.annotate import work_of
from rpl_data.clicks.log import click_event, keypoints_event
from rpl_data.geometry import invert, project, transform
from rpl_data.pipeline.build import build
from rpl_data.pipeline.recipe_file import load_recipe
from rpl_data.types import Recording, Trajectory
from rpl_data.workspace.workspace import Workspace

TWIN = """
name: bench
twin: {objects: [carton], scenes: 10, seconds: 0.4, clicks_per_keypoint: 1, click_noise_px: 1}
label: {rate: all}
"""
LONG = """
name: long
scenes: [{path: nowhere}]
objects: [{name: carton, keypoints: 12}]
"""
SCENES, FRAMES = 20, 9000
CLICKS, CHANGES = 30, 20

WATCH = """async () => {
    const { app, onChange } = await import("/static/state/store.js");
    window.taken = [];
    window.released = null;
    window.addEventListener("pointerup", () => (window.released = performance.now()), true);
    onChange(() => {
        if (window.released === null || app.waiting || app.result?.revision !== app.state.revision) return;
        const started = window.released;
        window.released = null;
        requestAnimationFrame(() => window.taken.push(performance.now() - started));
    }, () => [app.result, app.state, app.waiting]);
}"""
SELECTED = """async () => {
    const { projectedKeypoints } = await import("/static/image/marks.js");
    const { app } = await import("/static/state/store.js");
    return projectedKeypoints()[app.keypoint];
}"""
GO = """async (row) => {
    const { goToRow } = await import("/static/image/frames.js");
    const { app, frame } = await import("/static/state/store.js");
    const started = performance.now();
    goToRow(row);
    const picture = document.getElementById("picture");
    while (picture.dataset.frame !== `${app.scene}/${frame()}`) await new Promise(requestAnimationFrame);
    return performance.now() - started;
}"""


def marked_workspace(folder: Path) -> Workspace:
    """10 scenes and 12 keypoints: the carton's 11 landmarks and the middle of its top."""
    workspace = Workspace(folder / "marked")
    if workspace.clicks_file("carton").exists():
        return workspace
    (folder / "twin.yaml").write_text(TWIN)
    build(load_recipe(folder / "twin.yaml"), workspace, until="clicks")
    names = (*workspace.load_annotation("carton").keypoints, "middle")
    workspace.append_events("carton", [keypoints_event(names), *middle_clicks(workspace)])
    return workspace


def middle_clicks(workspace: Workspace) -> list[dict[str, object]]:
    """A click a scene on the middle of the top, where its truth lies in the frame of another click."""
    annotation = workspace.load_annotation("carton")
    truth = Workspace(workspace.truth).load_solution("carton")
    ends = [annotation.keypoints.index(name) for name in ("top_back_left", "top_front_right")]
    middle = truth.model.points_object[ends].mean(axis=0)
    events: list[dict[str, object]] = []
    for name in workspace.scene_names():
        scene = workspace.load_scene(name)
        click = next(c for c in annotation.clicks if c.scene == name)
        camera_from_scene = invert(workspace.load_trajectory(scene).at(click.frame))
        point = transform(camera_from_scene @ truth.scene_from_object[name], middle[None])
        (u, v) = project(scene.intrinsics, point)[0]
        events.append(click_event(replace(click, keypoint=len(annotation.keypoints), u_px=u, v_px=v)))
    return events


def copied(workspace: Workspace, folder: Path) -> Workspace:
    """A workspace to be clicked in; the recording stays where it is."""
    shutil.copytree(workspace.root, folder, ignore=shutil.ignore_patterns("recording"))
    (folder / "recording").symlink_to(workspace.recording)
    return Workspace(folder)


def long_workspace(folder: Path, marked: Workspace) -> Workspace:
    """20 scenes of 9,000 frames, which show the pictures of the short ones over and over."""
    workspace = Workspace(folder / "long")
    (workspace.root).mkdir(exist_ok=True)
    (workspace.root / "recipe.yaml").write_text(LONG)
    for number in range(SCENES):
        name = f"{number:02d}"
        if workspace.trajectory_file(name).exists():
            continue
        short = marked.load_recording(f"{number % 10:02d}").scene
        poses = marked.load_trajectory(short).scene_from_camera
        frames = tuple(
            replace(short.frames[i % len(short.frames)], index=i, timestamp_s=i / 30) for i in range(FRAMES)
        )
        trajectory = Trajectory(np.arange(FRAMES), poses[np.arange(FRAMES) % len(poses)])
        workspace.save_recording(Recording(replace(short, name=name, frames=frames), trajectory))
    if not workspace.clicks_file("carton").exists():
        workspace.append_events("carton", [keypoints_event([str(k) for k in range(12)])])
    return workspace


def opened(browser: Browser, server: Server) -> tuple[Page, float]:
    """The page in a browser without a cache, and the seconds until a frame was shown."""
    page = browser.new_context(viewport={"width": 1280, "height": 720}, bypass_csp=True).new_page()
    page.context.add_cookies([toured(server.url)])
    started = time.perf_counter()
    page.goto(server.url)
    page.wait_for_selector(SHOWN)
    return page, time.perf_counter() - started


def settled(page: Page) -> None:
    """Wait until there is a result of what was done last."""
    asked = """async () => {
        const { app } = await import("/static/state/store.js");
        return Boolean(app.result) && !app.result.checking && !app.waiting
            && app.result.revision === app.state?.revision;
    }"""
    while not page.evaluate(asked):
        page.wait_for_timeout(20)


def free_place(page: Page, random: np.random.Generator) -> tuple[float, float]:
    """Somewhere on the picture where a click marks and does not take hold of another mark."""
    while True:
        x, y = on_page(page, *random.uniform((60, 60), (580, 420)))
        taken = """async ([x, y]) => {
            const { markAt } = await import("/static/image/marks.js");
            const box = document.getElementById("marks").getBoundingClientRect();
            return markAt(x - box.x, y - box.y) !== null;
        }"""
        if not page.evaluate(taken, [x, y]):
            return x, y


def times_of_clicks(page: Page, count: int) -> np.ndarray:
    """Milliseconds from the button's release to the updated result on the screen, one a click.

    Clicks are as good as a person's: 1 px beside where the selected keypoint is.
    """
    page.evaluate(WATCH)
    random = np.random.default_rng(0)
    for _ in range(count):
        page.keyboard.press("j")
        before = page.evaluate("window.taken.length")
        at = page.evaluate(SELECTED)
        page.mouse.click(*on_page(page, *(np.array(at) + random.normal(0, 1, 2))))
        page.wait_for_function(f"window.taken.length > {before}", timeout=30_000)
        page.keyboard.press("Control+z")  # the next one is done on the same clicks
        settled(page)
    return np.array(page.evaluate("window.taken"))


def from_nothing_ms(workspace: Workspace) -> float:
    """The baseline: every depth image read, every click lifted, then solved."""
    work, annotation = work_of(workspace), workspace.load_annotation("carton")
    started = time.perf_counter()
    observations = Lifter(SceneStore(workspace)).observations(annotation.clicks)
    solve_live(annotation, observations, work.solve).checked()
    return 1e3 * (time.perf_counter() - started)


def heap_mb(session: CDPSession) -> float:
    session.send("HeapProfiler.collectGarbage")
    metrics = session.send("Performance.getMetrics")["metrics"]
    return next(m["value"] for m in metrics if m["name"] == "JSHeapUsedSize") / 2**20


def resident_mb(pid: int) -> float:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmRSS")).split()[1]) / 1024


def soak(page: Page, server: Server, actions: int) -> list[tuple[int, float, float]]:
    """Clicks, moves, undos, changes of frame and scene; (actions, server MB, page MB) along the way."""
    session = page.context.new_cdp_session(page)
    session.send("Performance.enable")
    random, found = np.random.default_rng(1), []
    for number in range(actions + 1):
        if number % max(1, actions // 10) == 0:
            settled(page)
            found.append((number, resident_mb(server.process.pid), heap_mb(session)))
        match number % 8:
            case 0 | 1 | 2:
                page.mouse.click(*free_place(page, random))
            case 3 | 4:
                page.keyboard.press("Control+z")
            case 5:
                page.keyboard.press(".")
            case 6:
                page.keyboard.press("j")
            case 7:
                page.keyboard.press("PageDown")
    return found


def report(name: str, values: np.ndarray, limit: float, unit: str = "ms") -> None:
    median, worst = np.median(values), np.percentile(values, 95)
    record("annotate", name, float(median), unit, baseline=("wanted", limit))
    print(f"{name:44s} median {median:7.1f}  p95 {worst:7.1f} {unit}   wanted < {limit:g}", flush=True)


def main(folder: Path, actions: int) -> None:
    """Print everything."""
    marked = marked_workspace(folder)
    for name in ("timed", "soaked"):
        shutil.rmtree(folder / name, ignore_errors=True)
    long = long_workspace(folder, marked)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=FLAGS)
        server = Server(copied(marked, folder / "timed").root)
        page, _ = opened(browser, server)
        settled(page)
        page.evaluate(GO, 9)  # a frame without marks
        clicks = len(marked.load_annotation("carton").clicks)
        taken = times_of_clicks(page, CLICKS)
        baseline = min(from_nothing_ms(marked) for _ in range(3))
        report(f"click to result, 10 scenes, 12 keypoints, {clicks} clicks", taken, 150)
        print(f"{'  lifting and solving from nothing (baseline)':44s} {baseline:14.1f} ms   "
              f"ratio {baseline / np.median(taken):.1f}")  # fmt: skip
        page.context.close()
        server.kill()

        server = Server(long.root)
        print(f"{SCENES} scenes of {FRAMES} frames:")
        first = []
        for _ in range(4):
            page, seconds = opened(browser, server)
            first.append(seconds)
            page.context.close()
        print(f"  first view: {first[0]:.2f} s cold, {np.median(first[1:]):.2f} s warm   wanted < 2")
        page, _ = opened(browser, server)
        settled(page)
        rows = np.random.default_rng(0).choice(FRAMES, CHANGES, replace=False)
        fresh = np.array([page.evaluate(GO, int(row)) for row in rows])
        page.wait_for_timeout(500)
        again = np.array([page.evaluate(GO, int(row)) for row in rows])
        report("  frame change, first time", fresh, 300)
        report("  frame change, seen before", again, 100)
        requests: list[str] = []
        page.on("request", lambda request: requests.append(request.url))
        page.keyboard.press("PageDown")
        page.wait_for_function("document.getElementById('frame-text').textContent.includes('scene 01')")
        page.wait_for_timeout(1000)
        print(f"  requests of opening another scene: {len(requests)}, "
              f"server {resident_mb(server.process.pid):.0f} MB")  # fmt: skip
        page.context.close()
        server.kill()

        server = Server(copied(marked, folder / "soaked").root)
        page, _ = opened(browser, server)
        settled(page)
        for number, there, here in soak(page, server, actions):
            print(f"  after {number:5d} actions: server {there:6.1f} MB, page {here:5.1f} MB", flush=True)
        browser.close()
        server.kill()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--actions", type=int, default=shared(1000, least=200))
    options = parser.parse_args()
    if options.keep:
        options.keep.mkdir(parents=True, exist_ok=True)
        main(options.keep, options.actions)
    else:
        with tempfile.TemporaryDirectory() as made:
            main(Path(made), options.actions)
