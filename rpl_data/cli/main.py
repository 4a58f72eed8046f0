"""The command `rpl`: wiring only. What is heavy is imported inside the commands, so help is quick."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

# Before NumPy is loaded: our matrices are small, and threads that wait for one another make a solve of
# 0.15 s take more than a second on a busy machine.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from rpl_data.types import DataError  # noqa: E402

if TYPE_CHECKING:
    from rpl_data.pipeline.ledger import Ledger

HERE = Path(".")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; 0 when all is well, 1 with one line on stderr when the user can mend it."""
    from jsonargparse import auto_cli

    try:
        auto_cli(COMMANDS, args=None if arguments is None else list(arguments), prog="rpl", description=HELP)
    except DataError as error:
        print(f"rpl: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("rpl: interrupted; run the same command again and it goes on from here", file=sys.stderr)
        return 130
    return 0


def build(
    recipe: Path,
    workspace: Path | None = None,
    root: Path | None = None,
    workers: int | None = None,
    again: Literal["all"] | str | None = None,
) -> None:
    """Make everything a recipe asks for; only what is out of date is run.

    Stages, in order: twin, import, track, clicks, solve, surface, segment, label, export, quality, report.
    Interrupt it whenever you like: run again, it goes on.

    Args:
        recipe: the YAML file; datasets/recording.yaml explains every field.
        workspace: folder for everything that is made; workspaces/<name of the file> when left out.
        root: where the relative paths of the recipe start; the recipe's own folder when left out.
        workers: processes for labelling and rendering; as many as cores when left out, 1 = no other process.
        again: a stage to run again although nothing it depends on has changed, or `all`.
    """
    from rpl_data.pipeline.recipe import load_recipe

    _run(load_recipe(recipe, root=root), workspace or Path("workspaces") / recipe.stem, None, again, workers)


def import_(recipe: Path, workspace: Path = HERE, root: Path | None = None, again: bool = False) -> None:
    """Read the recordings of a recipe into a workspace; what is left out is counted and named.

    Args:
        recipe: the YAML file.
        workspace: folder for everything that is made.
        root: where the relative paths of the recipe start; the recipe's own folder when left out.
        again: even if nothing has changed.
    """
    from rpl_data.pipeline.recipe import load_recipe

    _run(load_recipe(recipe, root=root), workspace, "import", "import" if again else None)


def capture(
    out: Path,
    scene: str | None = None,
    seconds: float | None = None,
    countdown: int = 3,
    exposure: Literal["lock", "auto"] = "lock",
    preview: Literal["none", "browser"] = "none",
    width: int = 640,
    height: int = 480,
    fps: int = 30,
    serial: str | None = None,
    port: int = 8018,
) -> None:
    """Record a scene with a RealSense camera: colour, and depth aligned to it. Ctrl-C ends the recording.

    Put the object on a table among other things (texture helps the tracking), 0.4 to 0.8 m away, and walk
    slowly around it for 20 to 40 seconds. Turn the object over or move it, run the same command again for the
    next scene; three scenes or more give a test split. What is recorded is whole at every moment: when the
    camera is unplugged or the disk full, all before it is kept, and every lost frame is said.

    Then: `rpl check OUT` says whether the recording is good; datasets/realsense.yaml makes a dataset of it.

    Args:
        out: folder of the recording, of all its scenes; made when it is not there.
        scene: name of the scene; 00, 01, ... when left out.
        seconds: how long; until Ctrl-C when left out.
        countdown: seconds before the recording starts.
        exposure: `lock` holds exposure and white balance at what the automatic finds before the start, so
            that a place looks the same in every frame; `auto` lets them change.
        preview: `browser` shows colour and depth on a page of this machine.
        width: of the images, pixels.
        height: of the images, pixels.
        fps: images a second.
        serial: of the camera, where several are connected.
        port: of the preview.
    """
    from rpl_data.capture.camera import connected_camera
    from rpl_data.capture.live import CaptureOptions
    from rpl_data.cli.capture import record_scene

    options = CaptureOptions(width, height, fps, seconds, countdown, exposure)
    record_scene(
        connected_camera(serial), out, scene, options, preview_port=port if preview == "browser" else None
    )


def check(
    path: Path,
    format: str | None = None,
    names: tuple[str, ...] | None = None,
    metres_per_unit: float | None = None,
) -> None:
    """What is wrong with a recording, how sure that is, and what mends it; changes nothing.

    Looks at about 90 frames of every scene: gaps between frames, repeated images, blur, depth that is
    missing, lag and shift between colour and depth, and, where there are poses, how they are stored, the
    unit of depth and the intrinsics.

    Args:
        path: a folder of scenes, the folder of one scene, a recording kept in one file (`.bag`, `.db3`,
            `.klg`), or a recipe (`.yaml`): then its recordings, as the recipe reads and mends them.
        format: how the recording is stored; guessed when left out.
        names: only these scenes.
        metres_per_unit: of the depth images; what the format says when left out.
    """
    from tempfile import TemporaryDirectory

    from rpl_data.cli.check import recordings_at
    from rpl_data.cli.screen import print_diagnoses

    with TemporaryDirectory() as scratch:
        print_diagnoses(
            recordings_at(path, Path(scratch), format=format, names=names, metres_per_unit=metres_per_unit)
        )


def track(workspace: Path = HERE, again: bool = False) -> None:
    """Images to camera poses, for a recipe with `reconstruct: {method: track}`.

    Every frame is aligned to keyframes by brightness and depth. Frames that cannot be are left out of
    `trajectory.txt`, and named.

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: even if nothing has changed.
    """
    _stage(workspace, "track", again)


def solve(workspace: Path = HERE, again: bool = False) -> None:
    """Clicks to sparse models: where every keypoint is, and where the objects stand in every scene.

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: even if nothing has changed.
    """
    _stage(workspace, "solve", again)


def register(object: str, scene: str, workspace: Path = HERE) -> None:
    """Place a known object in one more scene, from three clicks there or more; its model stays as it is.

    Args:
        object: its name.
        scene: its name; the scene must be in the recordings of the recipe, its clicks in the workspace.
        workspace: a folder made by `rpl build` or `rpl import`.
    """
    from rpl_data.pipeline.build import recipe_of, run_step
    from rpl_data.pipeline.stages.solve import register_step
    from rpl_data.workspace.workspace import Workspace

    place = Workspace(workspace)
    entry = run_step(recipe_of(place), place, lambda context: register_step(context, object, scene))
    print("\n".join(entry.outcome.messages))


def surface(workspace: Path = HERE, again: bool = False) -> None:
    """Depth images to a surface near the objects, a scene.

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: even if nothing has changed.
    """
    _stage(workspace, "surface", again)


def segment(workspace: Path = HERE, again: bool = False) -> None:
    """Surfaces to the dense model of every object.

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: even if nothing has changed.
    """
    _stage(workspace, "segment", again)


def label(workspace: Path = HERE, again: bool = False, workers: int | None = None) -> None:
    """Poses, keypoints, boxes and masks of every object in the chosen frames.

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: even if nothing has changed.
        workers: processes; as many as cores when left out, 1 = no other process.
    """
    _stage(workspace, "label", again, workers)


def export(workspace: Path = HERE, labels: Literal["own", "truth"] = "own", again: bool = False) -> None:
    """Labels to the formats of the recipe, in export/ of the workspace.

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        labels: `own`, or `truth`: export/coco_truth with the same images, from the truth where it is known.
        again: even if nothing has changed.
    """
    _stage(workspace, "export", again)
    if labels == "truth":
        from rpl_data.pipeline.build import context_of
        from rpl_data.pipeline.stages.export import export_truth
        from rpl_data.workspace.workspace import Workspace

        summary = export_truth(context_of(Workspace(workspace)))
        print(f"{Workspace(workspace).export('coco_truth')}: {sum(summary.images.values())} images")


def quality(workspace: Path = HERE, again: bool = False) -> None:
    """Errors against truth, where the recipe has a twin or names the truth: mm, px, IoU.

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: even if nothing has changed.
    """
    ledger = _stage(workspace, "quality", again)
    if "quality" not in ledger.entries:
        raise DataError(
            f"the truth of {workspace} is not known; name it with `truth:` in the recipe and build again"
        )


def truth(
    recipe: Path, cads: Path, out: Path, root: Path | None = None, metres_per_unit: float = 1.0
) -> None:
    """True poses that came with recordings (BOP, YCB-Video, LabelFusion), as a file for `truth:` of a recipe.

    They are poses of CAD models, so the keypoints must be picked on these too: open the CAD in MeshLab, pick
    them in the order of the recipe (PickPoints) and save <object>.pp beside it. Labelling never sees them.

    Args:
        recipe: the YAML file; its objects are called as in the dataset (obj_000005, 006_mustard_bottle).
        cads: folder with <object>.obj (or .ply, .stl) and <object>.pp.
        out: the JSON file to write.
        root: where the relative paths of the recipe start; the recipe's own folder when left out.
        metres_per_unit: of the CADs; 0.001 for millimetres, as BOP's are.
    """
    from tempfile import TemporaryDirectory

    from rpl_data.cli.truth import write_true_poses
    from rpl_data.pipeline.recipe import load_recipe
    from rpl_data.recordings.open import open_scenes

    loaded = load_recipe(recipe, root=root)
    with TemporaryDirectory() as scratch:
        recordings = [
            recording
            for source in loaded.scenes
            for recording in open_scenes(**vars(source), unpack=lambda scene: Path(scratch) / scene)
        ]
        counts = write_true_poses(recordings, loaded, cads, out, metres_per_unit=metres_per_unit)
    for name, frames in counts.items():
        print(f"{name}: {frames} frames with a true pose")


def report(workspace: Path = HERE, again: bool = False) -> None:
    """The page to look at: pictures, clicks, models, counts, timings.

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: even if nothing has changed.
    """
    _stage(workspace, "report", again)


def status(workspace: Path = HERE) -> None:
    """What a workspace holds and what the next build would run.

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
    """
    from rpl_data.pipeline.build import STAGES, recipe_of, stale_steps
    from rpl_data.workspace.workspace import Workspace

    place = Workspace(workspace)
    found = stale_steps(recipe_of(place), place)
    for stage in STAGES:
        steps = found.get(stage)
        if steps is None:
            print(f"{stage:8s}  waits for the stages before it")
        elif not steps:
            print(f"{stage:8s}  not asked for")
        else:
            stale = [item or stage for item, holds in steps if not holds]
            print(f"{stage:8s}  {'to run: ' + ', '.join(stale) if stale else 'up to date'}")


def annotate(
    workspace: Path,
    recipe: Path | None = None,
    root: Path | None = None,
    host: str = "127.0.0.1",
    port: int = 8017,
) -> None:
    """Mark keypoints in the browser: opens a page that says what to do next. Ctrl-C ends it.

    Every click is on the disk before the page shows it as saved; end it whenever you like.

    Args:
        workspace: a folder made by `rpl build` or `rpl import`; with a recipe it may be empty.
        recipe: read its recordings into the workspace first.
        root: where the relative paths of the recipe start; the recipe's own folder when left out.
        host: the address to listen on; any but this machine's own asks for the token in the printed URL.
        port: where the page is served.
    """
    from rpl_data.cli.annotate import place_of, serve
    from rpl_data.pipeline.recipe import load_recipe

    place = place_of(host, port)
    if recipe is not None:
        _run(load_recipe(recipe, root=root), workspace, "clicks", None)
    print(f"open {place.url}\nend with Ctrl-C", flush=True)
    serve(workspace, place)


def clicks_import(file: Path, workspace: Path = HERE, proposed: bool = False) -> None:
    """Add the clicks of a CSV file; a click on the same keypoint in the same frame is replaced.

    Args:
        file: columns object,keypoint,scene,frame,u_px,v_px; a keypoint by name, or by number from 0.
        workspace: a folder made by `rpl build` or `rpl import`.
        proposed: the clicks are a program's (`python -m training.predict --clicks`): what a person decided
            stays, they only fill in keypoints that were not clicked in that scene nor declared not visible.
    """
    from rpl_data.pipeline.build import context_of
    from rpl_data.pipeline.stages.clicks import add_clicks
    from rpl_data.workspace.workspace import Workspace

    for name, count in add_clicks(context_of(Workspace(workspace)), file, proposed=proposed).items():
        print(f"{name}: {count} clicks added or changed")


def clicks_export(file: Path, workspace: Path = HERE) -> None:
    """Write the clicks of all objects to a CSV file.

    Args:
        file: is replaced.
        workspace: a folder made by `rpl build` or `rpl import`.
    """
    from rpl_data.files import write_text
    from rpl_data.pipeline.stages.clicks import clicks_table
    from rpl_data.workspace.workspace import Workspace

    write_text(file, clicks_table(Workspace(workspace)))


HELP = "Labelled pose, keypoint and mask datasets from RGB-D videos and a few clicks. Start with `rpl build`."
COMMANDS: dict[str, Any] = {
    "build": build,
    "status": status,
    "capture": capture,
    "check": check,
    "import": import_,
    "track": track,
    "annotate": annotate,
    "clicks": {
        "_help": "Clicks in and out as CSV files.",
        "import": clicks_import,
        "export": clicks_export,
    },
    "solve": solve,
    "register": register,
    "surface": surface,
    "segment": segment,
    "label": label,
    "export": export,
    "quality": quality,
    "truth": truth,
    "report": report,
}


def _stage(workspace: Path, stage: str, again: bool, workers: int | None = None) -> Ledger:
    """Run a stage of a workspace, and what is out of date before it."""
    from rpl_data.pipeline.build import recipe_of
    from rpl_data.workspace.workspace import Workspace

    return _run(recipe_of(Workspace(workspace)), workspace, stage, stage if again else None, workers)


def _run(
    recipe: Any, workspace: Path, until: str | None, again: str | None, workers: int | None = None
) -> Ledger:
    """Build with progress on the terminal, and say what came out."""
    from rpl_data.cli.screen import Screen, print_results
    from rpl_data.pipeline.build import STAGES, build
    from rpl_data.workspace.workspace import Workspace

    if again is not None and again not in (*STAGES, "all"):
        raise DataError(
            f"there is no stage {again!r} to run again; expected all or one of {', '.join(STAGES)}"
        )
    place = Workspace(workspace)
    with Screen() as screen:
        chosen = tuple(STAGES) if again == "all" else (again,) if again else ()
        ledger = build(recipe, place, until=until, again=chosen, workers=workers, tell=screen.tell)
    print_results(place, ledger, screen, until)
    return ledger


if __name__ == "__main__":
    sys.exit(main())
