"""The paper's Table I in miniature: eleven objects in 86 scenes, built whole; accuracy, and cost by stage.

    PYTHONPATH=. python tests/bench/bench_paper.py --root MESHES [--share 0.1] [--folder FOLDER]

`datasets/paper_twin.yaml` has the paper's numbers of keypoints and scenes per object, and as many labels.
Every tenth of its frames is rendered (`--share`); scenes and camera paths stay the same. One process does
all, so that CPU seconds are those of one step at a time: some 20 minutes of an idle core, more than half of
them for rendering. Stopped, the same command with the same folder goes on, and counts what was done before.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before Open3D starts its threads

import argparse
import json
import resource
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from rows import record

from rpl_data import DataError, Workspace, build, load_recipe
from rpl_data.evaluate.quality import compare_workspaces
from rpl_data.pipeline.progress import Progress
from rpl_data.pipeline.recipe import Recipe
from rpl_data.reconstruct.fused_frames import MOST_FRAMES
from rpl_data.twin import TwinSpec
from rpl_data.types import QualityRow
from training.reproduce.paper import TABLE_1, TABLE_1_MEAN
from training.reproduce.table1.worst import worst_scenes

PAPER_RECIPE = Path(__file__).parents[2] / "datasets" / "paper_twin.yaml"
PAPERS_IMAGES = {"scenes": 80, "images": 150_000}
BY_SCENE = ("track", "drift", "surface", "label")
MOST_LOOKED_AT = {"drift": 24, "surface": MOST_FRAMES}
"""Frames per scene that these stages look at, however many there are."""
BY_OBJECT = ("solve", "refine", "segment")
BY_FRAME = ("import", "export", "quality", "report")


# The run ------------------------------------------------------------------------------------------


def share_of_paper(root: Path, share: float, seed: int, only: Sequence[str]) -> Recipe:
    """The paper's recipe with this share of its frames, of some objects only where they are named."""
    recipe = load_recipe(PAPER_RECIPE, root=root)
    twin = recipe.twin
    assert twin is not None and twin.keep_hz is not None and not isinstance(twin.scenes, int)
    keep_hz = twin.keep_hz * share
    if only:
        objects = tuple(thing for thing in twin.things if thing.name in only)
        scenes = tuple(cast for cast in twin.scenes if set(cast.objects) <= set(only))
        twin = replace(twin, objects=objects, scenes=scenes)
    return replace(recipe, twin=replace(twin, keep_hz=keep_hz, seed=seed))


@dataclass(frozen=True)
class StepCost:
    """What one step took, in one process.

    Attributes:
        frames: how many it worked on, as the build counts them; 0 where it does not.
        peak_mb: the most memory that the process had held until then.
    """

    stage: str
    item: str
    cpu_s: float
    frames: int
    peak_mb: float


def counting(costs: Path) -> Callable[[Progress], None]:
    """What a build tells its progress to: adds a line to a file for every step that ran."""
    began: dict[tuple[str, str], float] = {}

    def tell(progress: Progress) -> None:
        step = progress.stage, progress.item
        if progress.state == "runs":
            began.setdefault(step, time.process_time())
        elif progress.state == "failed":
            print(progress, flush=True)
        elif progress.state == "ran":
            spent_s = time.process_time() - began[step]
            peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            cost = StepCost(*step, spent_s, progress.outcome.frames, peak_mb)
            with costs.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(cost)) + "\n")

    return tell


def read_costs(path: Path) -> list[StepCost]:
    """The steps' costs; of a step that ran several times, the last."""
    lines = (json.loads(line) for line in path.read_text(encoding="utf-8").splitlines())
    return list({(line["stage"], line["item"]): StepCost(**line) for line in lines}.values())


# Accuracy -----------------------------------------------------------------------------------------


def error_per_sigma(workspace: Workspace, truth: Workspace) -> dict[str, float]:
    """Root mean square of error / stated sigma of all labelled keypoints, by object; 1 where it is true."""
    found: dict[str, list[np.ndarray]] = {}
    for scene in workspace.labelled_scene_names():
        true = {
            (label.frame, one.object): one for label in truth.load_labels(scene) for one in label.instances
        }
        for label in workspace.load_labels(scene):
            for one in label.instances:
                off_px = np.linalg.norm(one.keypoints_px - true[label.frame, one.object].keypoints_px, axis=1)
                stated = np.isfinite(one.sigma_px) & (one.visibility > 0)
                found.setdefault(one.object, []).append((off_px / np.sqrt(2) / one.sigma_px)[stated])
    return {name: float(np.sqrt(np.mean(np.concatenate(each) ** 2))) for name, each in found.items()}


def print_accuracy(workspace: Workspace, truth: Workspace) -> None:
    """Print and record one row per object beside the paper's, which are of its own objects, and the means."""
    names = [thing.name for thing in load_recipe(PAPER_RECIPE).twin.things]  # type: ignore[union-attr]
    paper = dict(zip(names, TABLE_1, strict=True))
    rows, worst = compare_workspaces(workspace, truth), worst_scenes(workspace, truth)
    per_sigma = error_per_sigma(workspace, truth)
    print("| object | N_s | N_k | labels | mm | px | IoU | error / sigma | worst scene | the paper's |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for row in rows:
        scenes, theirs = len(workspace.load_placed(row.object).scene_from_object), paper[row.object]
        print(
            f"| {row.object} | {scenes} | {row.keypoints_known} | {row.frames} of {row.truth_frames} | "
            f"{figures(row)} | {per_sigma[row.object]:.2f} | {worst[row.object]} | "
            f"{theirs.error_3d_mm:.2f} mm, {theirs.error_2d_px:.2f} px, {theirs.iou:.3f} |"
        )
        for what, value, unit, other in (
            ("3D", row.error_3d_mean_mm, "mm", theirs.error_3d_mm),
            ("2D", row.error_2d_mean_px, "px", theirs.error_2d_px),
            ("masks off by", 1 - row.iou_full_mean, "(1 - IoU)", 1 - theirs.iou),
        ):
            record("paper", f"{row.object}: {what}", value, unit, baseline=("the paper's object", other))
        record("paper", f"{row.object}: error / stated sigma", per_sigma[row.object], "")
    means = [
        float(np.mean([getattr(row, name) for row in rows]))
        for name in ("error_3d_mean_mm", "error_2d_mean_px", "iou_full_mean")
    ]
    ours = f"{means[0]:.2f} mm, {means[1]:.2f} px, {means[2]:.3f}"
    print(f"means of {len(rows)} objects: {ours}; the paper's: {TABLE_1_MEAN}", flush=True)


def figures(row: QualityRow) -> str:
    """The cells of mm, px and IoU."""
    return f"{row.error_3d_mean_mm:.2f} | {row.error_2d_mean_px:.2f} | {row.iou_full_mean:.3f}"


# Costs --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class UnitCost:
    """CPU seconds of a stage: so much for each scene, and for each frame."""

    scene_s: float
    frame_s: float

    def of(self, frames: Sequence[float]) -> float:
        """Seconds for scenes of so many frames."""
        return self.scene_s * len(frames) + self.frame_s * sum(frames)


def unit_cost(steps: Sequence[StepCost]) -> UnitCost:
    """Least squares over scenes of different length; neither part is negative."""
    from scipy.optimize import nnls

    matrix = np.array([[1.0, step.frames] for step in steps])
    return UnitCost(*map(float, nnls(matrix, np.array([step.cpu_s for step in steps]))[0]))


def print_costs(costs: Sequence[StepCost], spec: TwinSpec, share: float) -> None:
    """Print and record what each stage took, and what it would take for the paper's labels and images."""
    of_stage = {stage: [c for c in costs if c.stage == stage] for stage in {c.stage: 0 for c in costs}}
    frames = [spec.frames(scene) for scene in range(len(spec.casts))]
    at_3_hz = [count / share for count in frames]
    at_30_hz = [PAPERS_IMAGES["images"] / PAPERS_IMAGES["scenes"]] * PAPERS_IMAGES["scenes"]
    of_objects = PAPERS_IMAGES["scenes"] / len(frames)  # each object in so many scenes, one object in each
    totals = np.zeros(3)
    print("| stage | steps | CPU s here | per scene | per frame | labels at 3 Hz | 150,000 images |")
    print("|---|---|---|---|---|---|---|")
    for stage, steps in of_stage.items():
        spent_s, units, many = sum(step.cpu_s for step in steps), "| ", [0.0, 0.0]
        if stage in BY_SCENE:
            unit = unit_cost(steps)
            units = f"{unit.scene_s:.2f} s | {1e3 * unit.frame_s:.1f} ms"
            most = MOST_LOOKED_AT.get(stage, np.inf)
            many = [unit.of(np.minimum(each, most).tolist()) for each in (at_3_hz, at_30_hz)]
        elif stage in BY_OBJECT:
            units = f"{spent_s / len(frames):.2f} s | "
            many = [spent_s, spent_s * of_objects]
        elif stage in BY_FRAME or stage == "twin":
            units = f" | {1e3 * spent_s / sum(frames):.1f} ms"
            many = [spent_s / sum(frames) * sum(each) for each in (at_3_hz, at_30_hz)]
        if stage != "twin":
            totals += [spent_s, *many]
        print(f"| {stage} | {len(steps)} | {spent_s:.1f} | {units} | {many[0]:,.0f} | {many[1]:,.0f} |")
        record("paper", f"CPU of {stage}, {sum(frames)} frames", spent_s, "s")
    print(f"| all but the twin | | {totals[0]:.0f} | | | {totals[1]:,.0f} | {totals[2]:,.0f} |")
    peak_mb = max(step.peak_mb for step in costs)
    record("paper", "peak memory", peak_mb, "MB")
    print(f"{sum(frames)} frames in {len(frames)} scenes; peak memory {peak_mb:.0f} MB")
    for step in (step for stage in BY_OBJECT for step in of_stage.get(stage, [])):
        print(f"{step.stage} {step.item}: {step.cpu_s:.1f} CPU s")


def main() -> None:
    """Build, print the tables, record the rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--root", type=Path, help="the folder that holds ycb/; nothing is run without it")
    parser.add_argument("--share", type=float, default=0.1, help="of the paper's frames")
    parser.add_argument("--seed", type=int, default=0, help="of everything random in the twin")
    parser.add_argument("--only", nargs="+", default=[], help="some of the objects")
    parser.add_argument("--folder", type=Path, help="where to work; a temporary folder when left out")
    told = parser.parse_args()
    if told.root is None:
        print("not run: it takes long, and meshes that are not part of this project; see --help")
        return
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as scratch:
        folder = told.folder or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        recipe = share_of_paper(told.root, told.share, told.seed, told.only)
        assert recipe.twin is not None
        workspace, costs = Workspace(folder / "workspace"), folder / "costs.jsonl"
        try:
            build(recipe, workspace, workers=1, keep_going=True, tell=counting(costs))
        except DataError as error:
            print(error, flush=True)
        print_accuracy(workspace, Workspace(workspace.recording / "truth"))
        print_costs(read_costs(costs), recipe.twin, told.share)


if __name__ == "__main__":
    main()
