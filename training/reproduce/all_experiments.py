"""All experiments of the paper on one recording, one after another, on one page."""

from __future__ import annotations

import shlex
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from rpl_data.files import read_json, write_json, write_text
from rpl_data.types import DataError

from ..runs.options import Precision

Run = Callable[[list[str]], int]
"""Runs a command line of `rpl reproduce`; its exit status comes back."""


@dataclass(frozen=True)
class Preset:
    """What `rpl reproduce all` runs with.

    Attributes:
        recipe: of the recording, in datasets/.
        objects: how many of its objects are in Table II; all when None.
        table2, masks: presets of the networks.
    """

    recipe: str
    objects: int | None
    table2: str
    masks: str


@dataclass(frozen=True)
class TrainingOptions:
    """What the person chose of the trainings.

    Attributes:
        weights: what the mask networks start from.
        seeds: trainings per network of Table II.
        precision: of all trainings.
    """

    weights: str | None = None
    seeds: int = 1
    precision: Precision | None = None


PRESETS: Mapping[str, Preset] = {
    "cpu": Preset("training_twin.yaml", None, "table2_cpu", "masks_cpu"),
    "paper": Preset("paper_twin.yaml", 3, "table2_paper", "masks_paper"),
}


def reproduce_all(
    preset: Literal["cpu", "paper"] = "cpu",
    out: Path = Path("runs/all"),
    recipe: Path | None = None,
    root: Path | None = None,
    weights: str | None = None,
    seeds: int = 1,
    precision: Precision | None = None,
    workers: int | None = None,
) -> None:
    """All of the paper's experiments on one recording: a page with their tables and figures.

    Builds the recording, then runs table1, curves, ablation, segmentation and table2. Interrupt it whenever
    you like: the same command goes on where it was. all.html is written anew after each experiment. Where
    one fails it says so, the terminal says why, and the next one runs all the same.

    Args:
        preset: `cpu` takes datasets/training_twin.yaml and small networks, about two hours on two cores;
            `paper` datasets/paper_twin.yaml (eleven objects) and the paper's networks, for a GPU.
        out: folder for all.html, the recording and one folder per experiment.
        recipe: of another recording; `datasets/` of the folder you are in holds the presets'.
        root: where the meshes are that the recipe names; paper_twin.yaml needs those of YCB.
        weights: what the mask networks start from: `scratch`, `imagenet`, or a file; the preset's when left
            out.
        seeds: trainings per network of Table II.
        precision: of all trainings, `bf16-mixed` for example; the presets' when left out.
        workers: processes; one per core when left out.
    """
    from .commands import run_command

    chosen = PRESETS[preset]
    source = recipe or Path("datasets") / chosen.recipe
    if not source.is_file():
        raise DataError(f"there is no recipe {source}; run this in a checkout of rpl-data, or give --recipe")
    workspace = out / "workspaces" / source.stem
    objects = _built(source, workspace, root, workers)
    trainings = TrainingOptions(weights, seeds, precision)
    commands = command_lines(chosen, workspace, objects, out, trainings, workers=workers)
    failed = run_all(commands, out, run_command)
    print(out / "all.html")
    if failed:
        raise DataError(f"{', '.join(failed)} failed, as the lines above say; give the same command again")


def _built(source: Path, workspace: Path, root: Path | None, workers: int | None) -> list[str]:
    """Build a recipe, or what is missing of it; the names of its objects come back."""
    from rpl_data.pipeline.recipe_file import load_recipe
    from rpl_data.workspace.workspace import Workspace

    from .building import build_and_tell

    place = Workspace(workspace)
    build_and_tell(load_recipe(source, root=root), place, workers=workers)
    return list(place.object_names())


def command_lines(
    preset: Preset,
    workspace: Path,
    objects: list[str],
    out: Path,
    trainings: TrainingOptions,
    *,
    workers: int | None,
) -> dict[str, list[str]]:
    """The command line of each experiment, by its name, the quick ones first."""
    several = _option("workers", workers)
    tested = f"[{', '.join(objects[: preset.objects])}]"
    masks = [*_option("weights", trainings.weights), *_option("precision", trainings.precision)]
    poses = [*_option("seeds", trainings.seeds), *_option("machine.precision", trainings.precision)]
    told = {
        "table1": [str(workspace), *several],
        "curves": several,
        "ablation": [str(workspace), *several],
        "segmentation": [str(workspace), "--preset", preset.masks, *masks],
        "table2": [str(workspace), tested, "--config", preset.table2, *poses],
    }
    return {name: [name, *words, "--out", str(out / name)] for name, words in told.items()}


def _option(name: str, value: object) -> list[str]:
    """An option of a command line; nothing where it was left out."""
    return [] if value is None else [f"--{name}", str(value)]


def run_all(commands: Mapping[str, list[str]], out: Path, run: Run) -> list[str]:
    """Run the experiments that are not done yet; the names of those that failed come back.

    `all.json` keeps which command lines are done, so that a changed one runs again.

    Raises:
        SystemExit: an experiment was interrupted, and has said so.
    """
    from ..runs.program import INTERRUPTED

    kept = out / "all.json"
    done: dict[str, dict[str, object]] = read_json(kept) if kept.exists() else {}
    failed = []
    for name, command in commands.items():
        if done.get(name, {}).get("command") == command:
            continue
        started = time.perf_counter()
        status = _status(run, command)
        if status == INTERRUPTED:
            raise SystemExit(INTERRUPTED)
        if status:
            failed.append(name)
            done.pop(name, None)
        else:
            done[name] = {"command": command, "minutes": (time.perf_counter() - started) / 60}
        write_json(kept, done)
        write_page(out, commands, done, failed)
    write_page(out, commands, done, failed)
    return failed


def _status(run: Run, command: list[str]) -> int:
    """The exit status of an experiment; 1 after a fault of the program, with all about it on stderr."""
    try:
        return run(command)
    except Exception:  # full memory, say: the other experiments are worth having all the same
        traceback.print_exc()
        return 1


def write_page(
    out: Path,
    commands: Mapping[str, list[str]],
    done: Mapping[str, Mapping[str, object]],
    failed: list[str],
) -> Path:
    """Write all.html: what has run, and the page of each experiment, closed until it is clicked."""
    from rpl_data.report.html import body_of, folded, number, page, table, text

    rows, parts = [], []
    for name, command in commands.items():
        state = "done" if name in done else "failed" if name in failed else "not yet"
        minutes = done.get(name, {}).get("minutes")
        shown = number(minutes, 1) if isinstance(minutes, float) else ""
        rows.append([name, state, f"rpl reproduce {shlex.join(command)}", shown])
        own = out / name / f"{name}.html"
        if own.exists():
            parts.append(folded(name, body_of(own.read_text(encoding="utf-8"))))
    head = f'<header><h1>The paper\'s experiments</h1><p class="sub">{text(out)}</p></header>'
    overview = table(("experiment", "state", "command", "minutes"), rows, left=3)
    path = out / "all.html"
    write_text(path, page("The paper's experiments", head + overview + "".join(parts)))
    return path
