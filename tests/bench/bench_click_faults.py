"""What is said of wrong clicks: faults are planted in redrawn clicks of rendered workspaces, and counted.

Run: python tests/bench/bench_click_faults.py [WORKSPACE...] [--runs 100] [--clicks 1,3] [--faults slip15]
The workspaces are built from twins; that of `make demo` where none is named. Nothing is rendered: each run
draws new clicks on the images that are there, plants one fault and solves, in a fraction of a second. Scored
by verdict and by object:

right     The wrong clicks are blamed and no others.
asks      They are said to disagree with others, and nothing could tell which is wrong: with another click
          left out in their place everything fits about as well (`RIVAL`), even fitted from the truth.
partly    Of a mirrored scene only some clicks are blamed or doubted, and no click of another scene is blamed.
evades    They are said to disagree although the clicks could tell which is wrong.
unseen    Nothing is said, and nothing could be: even fitted from the truth, and knowing which click to leave
          out, the clicks fit no better than chance allows (`evidence` below the doctor's own bar).
missed    Nothing is said although it could have been.
accuses   A good click is blamed.
alarm     Anything is said of clean clicks.

The clean runs also give the calibration: the root mean square of true over expected error of the keypoints in
each scene, which is 1 when "± mm" on the page is right.
"""

from __future__ import annotations

import argparse
import os
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as `rpl` does, before NumPy is loaded

import numpy as np
from rows import record, shared

from rpl_data.clicks.lift import lift
from rpl_data.geometry import invert, project, transform
from rpl_data.solve.click_rays import rays_of
from rpl_data.solve.explanations import RIVAL, contradiction
from rpl_data.solve.refit import read_as_named, refit
from rpl_data.solve.solve import solve
from rpl_data.twin.annotator import click
from rpl_data.types import HINTS, Click, DataError, Observation, Solution
from rpl_data.workspace.workspace import Workspace

DEMO = Path(__file__).parents[2] / "workspaces/demo"
NOISE_PX = 2.0
FAR_MM = 10.0
"""A scene whose keypoints are no farther off needs no warning, however its clicks lie."""


@dataclass(frozen=True)
class Planted:
    """Clicks with a fault; `wrong` names the wrong ones, `scene` where they are."""

    clicks: list[Click]
    scene: str = ""
    wrong: frozenset[Click] = frozenset()


@dataclass
class Tally:
    """Runs of one fault and one number of clicks."""

    verdicts: Counter[tuple[str, str]] = field(default_factory=Counter)
    seconds: list[float] = field(default_factory=list)
    squared: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))


class Redrawn:
    """A workspace built from a twin, whose objects are clicked anew."""

    def __init__(self, root: Path) -> None:
        workspace = Workspace(root)
        truth = Workspace(workspace.truth)
        self.workspace = workspace
        self.scenes = {name: workspace.load_scene(name) for name in workspace.scene_names()}
        self.trajectories = {name: workspace.load_trajectory(s) for name, s in self.scenes.items()}
        self.truth: dict[str, Solution] = {name: truth.load_solution(name) for name in truth.object_names()}
        self.labels = {name: list(truth.load_labels(name)) for name in self.scenes}
        self._depth: dict[tuple[str, int], np.ndarray] = {}

    def clicks(self, name: str, per: int, rng: np.random.Generator) -> list[Click]:
        return [
            one
            for scene in sorted(self.truth[name].scene_from_object)
            for one in click(
                self.labels[scene], name, intrinsics=self.scenes[scene].intrinsics,
                clicks_per_keypoint=per, noise_px=NOISE_PX, rng=rng,
            )
        ]  # fmt: skip

    def lifted(self, one: Click) -> Observation:
        scene = self.scenes[one.scene]
        key = one.scene, one.frame
        if key not in self._depth:
            self._depth[key] = self.workspace.depth_reader(scene)(scene.frame(one.frame))
        return lift(one, scene.intrinsics, self.trajectories[one.scene].at(one.frame), self._depth[key])

    def moved(self, one: Click, uv: Sequence[float]) -> Click:
        """The click elsewhere, in the image."""
        camera = self.scenes[one.scene].intrinsics
        u, v = np.clip(uv, 0, [camera.width - 1, camera.height - 1]).tolist()
        return replace(one, u_px=u, v_px=v)

    def true_px(self, one: Click) -> np.ndarray:
        """Where all keypoints are in the frame of a click."""
        truth = self.truth[one.object]
        camera_from_scene = invert(self.trajectories[one.scene].at(one.frame))
        points = transform(camera_from_scene @ truth.scene_from_object[one.scene], truth.model.points_object)
        return project(self.scenes[one.scene].intrinsics, points)

    def error_mm(self, solution: Solution, scene: str) -> float:
        """True error of the keypoints in a scene, root mean square."""
        truth = self.truth[solution.model.name]
        found = transform(solution.scene_from_object[scene], solution.model.points_object)
        right = transform(truth.scene_from_object[scene], truth.model.points_object)
        return 1e3 * float(np.sqrt(np.nanmean(((found - right) ** 2).sum(axis=1))))


# Faults -------------------------------------------------------------------------------------------


def clean(of: Redrawn, clicks: list[Click], rng: np.random.Generator) -> Planted:
    return Planted(clicks)


def swapped(of: Redrawn, clicks: list[Click], rng: np.random.Generator) -> Planted:
    scene, here = _scene(clicks, rng)
    a, b = rng.choice(here, 2, replace=False).tolist()
    other = {a: b, b: a}
    return _changed(
        clicks, scene, lambda c: replace(c, keypoint=other[c.keypoint]) if c.keypoint in other else c
    )


def wrong_keypoint(of: Redrawn, clicks: list[Click], rng: np.random.Generator) -> Planted:
    scene, here = _scene(clicks, rng)
    a, b = rng.choice(here, 2, replace=False).tolist()
    return _changed(
        clicks, scene,
        lambda c: of.moved(c, of.true_px(c)[b] + rng.normal(0, NOISE_PX, 2)) if c.keypoint == a else c,
    )  # fmt: skip


def slipped(px: float) -> Callable[[Redrawn, list[Click], np.random.Generator], Planted]:
    def plant(of: Redrawn, clicks: list[Click], rng: np.random.Generator) -> Planted:
        scene, _ = _scene(clicks, rng)
        own = [c for c in clicks if c.scene == scene]
        slip, angle = own[rng.integers(len(own))], rng.uniform(0, 2 * np.pi)
        there = slip.u_px + px * np.cos(angle), slip.v_px + px * np.sin(angle)
        return _changed(clicks, scene, lambda c: of.moved(c, there) if c == slip else c)

    return plant


def mirrored(of: Redrawn, clicks: list[Click], rng: np.random.Generator) -> Planted:
    """A scene clicked in mirrored images: about the middle of the object, left for right."""
    scene, here = _scene(clicks, rng)

    def mirror(one: Click) -> Click:
        across = of.true_px(one)[here, 0]
        return of.moved(one, (across.min() + across.max() - one.u_px, one.v_px))

    return _changed(clicks, scene, mirror)


def collinear(of: Redrawn, clicks: list[Click], rng: np.random.Generator) -> Planted:
    """Of one scene only the three keypoints nearest to a line; all of them are right."""
    scene, here = _scene(clicks, rng)
    points = of.truth[clicks[0].object].model.points_object

    def width(three: tuple[int, ...]) -> float:
        spread = points[list(three)] - points[list(three)].mean(axis=0)
        return float(np.linalg.svd(spread, compute_uv=False)[1])

    kept = min(combinations(here, 3), key=width)
    return Planted([c for c in clicks if c.scene != scene or c.keypoint in kept], scene)


def _scene(clicks: list[Click], rng: np.random.Generator) -> tuple[str, list[int]]:
    """A scene with at least four keypoints, and those."""
    shown = {c.scene: sorted({d.keypoint for d in clicks if d.scene == c.scene}) for c in clicks}
    scene = str(rng.choice([s for s, here in shown.items() if len(here) >= 4]))
    return scene, shown[scene]


def _changed(clicks: list[Click], scene: str, change: Callable[[Click], Click]) -> Planted:
    found = [change(c) if c.scene == scene else c for c in clicks]
    wrong = frozenset(b for a, b in zip(clicks, found, strict=True) if a != b)
    return Planted(found, scene, wrong)


FAULTS = {
    "clean": clean, "swapped": swapped, "wrong_keypoint": wrong_keypoint, "slip30": slipped(30.0),
    "slip15": slipped(15.0), "mirrored": mirrored, "collinear": collinear,
}  # fmt: skip


# Verdicts -----------------------------------------------------------------------------------------


def verdict(
    of: Redrawn, fault: str, planted: Planted, observations: list[Observation], found: Solution
) -> str:
    said = [s for s in found.statements if s.kind not in HINTS]
    if fault == "collinear":
        named = any(s.kind == "weak scene" and s.clicks[0].scene == planted.scene for s in found.statements)
        return "right" if named or of.error_mm(found, planted.scene) < FAR_MM else "missed"
    if fault == "clean":
        return "alarm" if said else "right"
    blamed = {c for s in said if s.blames for c in s.clicks}
    doubted = {c for s in said if not s.blames for c in s.clicks}
    if blamed - planted.wrong:
        return "accuses"
    if fault == "mirrored":
        whole = any(s.kind == "whole scene" for s in said)
        return "right" if whole else "partly" if blamed or doubted & planted.wrong else "missed"
    if blamed:
        return "right"
    own = evidence(of, planted, observations, planted.wrong)
    if doubted & planted.wrong:
        rivals = max(evidence(of, planted, observations, {c}) for c in _rivals(planted))
        return "asks" if rivals > own - RIVAL else "evades"
    return "missed" if own >= contradiction(len(observations)) else "unseen"


def _rivals(planted: Planted) -> list[Click]:
    """Clicks that could be wrong in place of those that are: on their keypoint, or in their scene."""
    keypoints = {c.keypoint for c in planted.wrong}
    return [
        c for c in planted.clicks
        if c not in planted.wrong and (c.scene == planted.scene or c.keypoint in keypoints)
    ]  # fmt: skip


def evidence(
    of: Redrawn, planted: Planted, observations: list[Observation], left_out: Collection[Click]
) -> float:
    """Fall of the cost when clicks are left out, fitted from the truth: twice a log-likelihood ratio.

    The depths beside those clicks count on neither side.
    """
    truth = of.truth[planted.clicks[0].object]
    scenes = sorted({o.click.scene for o in observations})
    rays = rays_of(observations, scenes)
    start = np.stack([truth.scene_from_object[s] for s in scenes]), np.nan_to_num(truth.model.points_object)
    good = np.array([o.click not in left_out for o in observations])
    reading = read_as_named(rays)._replace(depth_used=good)
    kept = refit(rays, reading, *start, sigma_px=NOISE_PX, most_steps=60)
    without = refit(rays, reading._replace(ray_used=good), *start, sigma_px=NOISE_PX, most_steps=60)
    return kept.cost - without.cost


def main(roots: Sequence[Path], faults: Sequence[str], clicks: Sequence[int], runs: int, seed: int) -> None:
    """Print the table and what was not right."""
    places = [(of, name) for of in map(Redrawn, roots) for name in sorted(of.truth)]
    tallies: dict[tuple[str, int], Tally] = defaultdict(Tally)
    for fault in faults:
        for per in clicks:
            for run in range(runs):
                of, name = places[run % len(places)]
                rng = np.random.default_rng([seed, run, list(FAULTS).index(fault), per])
                told = one_run(of, name, fault, per, rng, tallies[fault, per])
                if told:
                    print(f"{fault} {per} run {run} {name}: {told}", flush=True)
            print_row(fault, per, tallies[fault, per])


def one_run(of: Redrawn, name: str, fault: str, per: int, rng: np.random.Generator, tally: Tally) -> str:
    """Count one run; what was not right in words."""
    planted = FAULTS[fault](of, of.clicks(name, per, rng), rng)
    observations = [of.lifted(c) for c in planted.clicks]
    begin = time.process_time()
    try:
        found = solve(name, of.truth[name].model.keypoints, observations)
    except DataError as error:
        told = "right" if planted.scene and planted.scene in str(error) else "refused"
        tally.verdicts[name, told] += 1
        return "" if told == "right" else str(error)[:150]
    tally.seconds.append(time.process_time() - begin)
    said = verdict(of, fault, planted, observations, found)
    tally.verdicts[name, said] += 1
    if fault == "clean":
        tally.squared[name] += [(of.error_mm(found, s) / mm) ** 2 for s, mm in found.expected_mm.items()]
    if said == "right":
        return ""
    where = sorted((c.scene, c.frame, c.keypoint) for c in planted.wrong)[:2]
    extra = (
        f", evidence {evidence(of, planted, observations, planted.wrong):.1f}"
        if fault.startswith("slip")
        else ""
    )
    return (
        f"{said}{extra}; wrong {where}; said {[(s.kind, s.evidence, s.text[:90]) for s in found.statements]}"
    )


def print_row(fault: str, per: int, tally: Tally) -> None:
    """One line of the table, then the share of right statements and the calibration by object."""
    counts: Counter[str] = Counter()
    for (_, told), count in tally.verdicts.items():
        counts[told] += count
    runs = sum(counts.values())
    if fault == "clean":
        record(
            "click_faults", f"{per} per keypoint: false alarms", counts["alarm"] / runs, "share", asked=0.02
        )
    else:
        work = f"{fault}, {per} per keypoint: right statements"
        record("click_faults", work, counts["right"] / runs, "share", asked=0.95, more_is_better=True)
    ms = 1e3 * np.array(tally.seconds or [np.nan])
    others = ", ".join(f"{told} {n}" for told, n in counts.most_common() if told != "right")
    print(
        f"== {fault:15s} {per} click(s)  right {counts['right']:3d} of {runs}  [{others}]  "
        f"CPU median {np.median(ms):.0f}, p95 {np.percentile(ms, 95):.0f} ms", flush=True,
    )  # fmt: skip
    for name in sorted({name for name, _ in tally.verdicts}):
        own = {told: n for (other, told), n in tally.verdicts.items() if other == name}
        ratio = (
            f"  true/expected {np.sqrt(np.mean(tally.squared[name])):.2f}" if name in tally.squared else ""
        )
        print(f"      {name:18s} right {own.get('right', 0)} of {sum(own.values())}{ratio}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("workspaces", type=Path, nargs="*")
    parser.add_argument("--faults", default=",".join(FAULTS))
    parser.add_argument("--clicks", default="1,3")
    parser.add_argument("--runs", type=int, default=shared(100, least=20))
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    counts = [int(n) for n in asked.clicks.split(",")]
    main(asked.workspaces or [DEMO], asked.faults.split(","), counts, asked.runs, asked.seed)
