"""The command `rpl`: wiring only. What is heavy is imported inside the commands, so help is quick."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

# Before NumPy is loaded: our matrices are small, and threads that wait for one another make a solve of
# 0.15 s take more than a second on a busy machine.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from rpl_data.cli.building import run_build  # noqa: E402
from rpl_data.cli.stages import (  # noqa: E402
    HERE,
    cut,
    drift,
    export,
    label,
    quality,
    refine,
    report,
    segment,
    solve,
    surface,
    track,
)
from rpl_data.types import DataError  # noqa: E402


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; 0 when all is well, 1 with one line on stderr when the user can mend it."""
    try:
        from rpl_data.command_line import run

        run(COMMANDS, arguments, program="rpl", description=HELP)
    except DataError as error:
        print(f"rpl: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("rpl: interrupted; run the same command again and it goes on from here", file=sys.stderr)
        return 130
    except BrokenPipeError:  # whoever read our output has gone, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:  # a fault of ours: the last net, so that nobody is shown a page of code
        from rpl_data.cli.faults import reported

        print(f"rpl: {reported(error, sys.argv[1:] if arguments is None else arguments)}", file=sys.stderr)
        return 1
    return 0


# Not called `build`: the parser would look for it in rpl_data, which then imports everything.
def build_recipe(
    recipe: Path,
    workspace: Path | None = None,
    root: Path | None = None,
    workers: int | None = None,
    again: str | None = None,
) -> None:
    """Make everything a recipe asks for; only what is out of date is run.

    Stages, in order: twin, import, clicks, track, drift, cut, solve, surface, refine, segment, label,
    export, quality, report. Interrupt it whenever you like: run it again and it goes on from there.

    Example: rpl build datasets/demo.yaml --workspace workspaces/demo

    Args:
        recipe: the YAML file; datasets/recording.yaml explains every field.
        workspace: folder for everything that is made; workspaces/<name of the file> when left out.
        root: where the relative paths of the recipe start; the recipe's own folder when left out.
        workers: number of processes for labelling and rendering; as many as there are cores when left out,
            1 = only this one.
        again: a stage to run again although nothing it depends on has changed, or `all`.
    """
    from rpl_data.pipeline.recipe_file import load_recipe

    run_build(
        load_recipe(recipe, root=root), workspace or Path("workspaces") / recipe.stem, None, again, workers
    )


def import_(recipe: Path, workspace: Path = HERE, root: Path | None = None, again: bool = False) -> None:
    """Read the recordings of a recipe into a workspace; what is left out is counted and named.

    Example: rpl import my.yaml --root my-recording --workspace my-workspace

    Args:
        recipe: the YAML file.
        workspace: folder for everything that is made.
        root: where the relative paths of the recipe start; the recipe's own folder when left out.
        again: run the stage even if nothing it depends on has changed.
    """
    from rpl_data.pipeline.recipe_file import load_recipe

    run_build(load_recipe(recipe, root=root), workspace, "import", "import" if again else None)


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
    next scene; three scenes or more give a test split. The recording is whole at every moment: when the
    camera is unplugged or the disk is full, everything before that is kept, and every lost frame is reported.

    Then `rpl check OUT` says whether the recording is good; datasets/realsense.yaml makes a dataset of it.

    Example: rpl capture my-recording --seconds 30 --preview browser

    Args:
        out: folder of the recording, of all its scenes; made when it is not there.
        scene: name of the scene; 00, 01, ... when left out.
        seconds: how long; until Ctrl-C when left out.
        countdown: seconds before the recording starts.
        exposure: `lock` holds exposure and white balance at what the automatic finds before the start, so
            that a place looks the same in every frame; `auto` lets them change.
        preview: `browser` shows colour and depth on a page of this machine.
        width: width of the images, pixels.
        height: height of the images, pixels.
        fps: images per second.
        serial: serial number of the camera, where several are connected.
        port: port of the preview's page.
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
    """Say what is wrong with a recording, how sure that is, and what mends it; changes nothing.

    Looks at about 90 frames of each scene: gaps between frames, repeated images, blur, missing depth, lag and
    shift between colour and depth and, where there are poses, how they are stored, the unit of depth and the
    intrinsics.

    Example: rpl check my-recording

    Args:
        path: a folder of scenes, the folder of one scene, a recording kept in one file (`.bag`, `.db3`,
            `.klg`), or a recipe (`.yaml`): then its recordings, as the recipe reads and mends them.
        format: how the recording is stored; guessed when left out.
        names: only these scenes, as '["00", "01"]'.
        metres_per_unit: metres per unit of the depth images; what the format says when left out.
    """
    from tempfile import TemporaryDirectory

    from rpl_data.cli.check import recordings_at
    from rpl_data.cli.screen import print_diagnoses

    with TemporaryDirectory() as scratch:
        print_diagnoses(
            recordings_at(path, Path(scratch), format=format, names=names, metres_per_unit=metres_per_unit)
        )


def register(object: str, scene: str, workspace: Path = HERE) -> None:
    """Place a known object in one more scene, from three clicks there or more; its model stays as it is.

    Example: rpl register cube 04 --workspace my-workspace

    Args:
        object: name of the object.
        scene: name of the scene, which must be in the recordings of the recipe; its clicks must be in the
            workspace.
        workspace: a folder made by `rpl build` or `rpl import`.
    """
    from rpl_data.pipeline.build import recipe_of, run_step
    from rpl_data.pipeline.stages.solve import register_step
    from rpl_data.workspace.workspace import Workspace

    place = Workspace(workspace)
    entry = run_step(recipe_of(place), place, lambda context: register_step(context, object, scene))
    print("\n".join(entry.outcome.messages))


def truth(
    recipe: Path, cads: Path, out: Path, root: Path | None = None, metres_per_unit: float = 1.0
) -> None:
    """Write the true poses that came with recordings to a file for `truth:` of a recipe.

    BOP, YCB-Video and LabelFusion have poses of CAD models, so the keypoints must be picked on the CAD models
    too: open each in MeshLab, pick the keypoints in the order of the recipe (PickPoints) and save <object>.pp
    beside it. Labelling never sees these poses.

    Example: rpl truth my.yaml models truth.json --metres_per_unit 0.001

    Args:
        recipe: the YAML file; its objects are called as in the dataset (obj_000005, 006_mustard_bottle).
        cads: folder with <object>.obj (or .ply, .stl) and <object>.pp.
        out: the JSON file to write.
        root: where the relative paths of the recipe start; the recipe's own folder when left out.
        metres_per_unit: metres per unit of the CAD models; 0.001 for millimetres, as in BOP.
    """
    from tempfile import TemporaryDirectory

    from rpl_data.cli.truth import write_true_poses
    from rpl_data.pipeline.recipe_file import load_recipe
    from rpl_data.pipeline.sources import recordings_of

    loaded = load_recipe(recipe, root=root)
    with TemporaryDirectory() as scratch:
        recordings = recordings_of(loaded.scenes, unpack=Path(scratch).joinpath)
        counts = write_true_poses(recordings, loaded, cads, out, metres_per_unit=metres_per_unit)
    for name, frames in counts.items():
        print(f"{name}: {frames} frames with a true pose")


def status(workspace: Path = HERE) -> None:
    """Say which stages of a workspace are up to date and what the next build would run; changes nothing.

    Example: rpl status --workspace workspaces/demo

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
    """Mark keypoints in the browser, on a page that says what to do next. Ctrl-C ends it.

    Every click is on the disk before the page shows it as saved; end it whenever you like.

    Example: rpl annotate my-workspace --recipe my.yaml --root my-recording

    Args:
        workspace: a folder made by `rpl build` or `rpl import`; with a recipe it may be empty.
        recipe: read its recordings into the workspace first.
        root: where the relative paths of the recipe start; the recipe's own folder when left out.
        host: the address to listen on; any other than this machine's own asks for the token in the printed
            URL.
        port: where the page is served.
    """
    from rpl_data.cli.annotate import address_of, listening, serve
    from rpl_data.pipeline.recipe_file import load_recipe

    address = address_of(host, port)
    if recipe is not None:
        run_build(load_recipe(recipe, root=root), workspace, "clicks", None)
    taken, address = listening(address)
    with taken:
        serve(
            workspace, address, taken, ready=lambda: print(f"open {address.url}\nend with Ctrl-C", flush=True)
        )


def clicks_import(file: Path, workspace: Path = HERE, proposed: bool = False) -> None:
    """Add the clicks of a CSV file; a click on the same keypoint in the same frame is replaced.

    Example: rpl clicks import corrected.csv --workspace my-workspace

    Args:
        file: columns object,keypoint,scene,frame,u_px,v_px; a keypoint by name, or by number from 0.
        workspace: a folder made by `rpl build` or `rpl import`.
        proposed: the clicks are a program's (`python -m training.predict --clicks`): what a person decided
            stays, and they only fill in keypoints that were neither clicked in that scene nor declared not
            visible there.
    """
    from rpl_data.pipeline.build import context_of
    from rpl_data.pipeline.stages.clicks import add_clicks
    from rpl_data.workspace.workspace import Workspace

    for name, count in add_clicks(context_of(Workspace(workspace)), file, proposed=proposed).items():
        print(f"{name}: {count} clicks added or changed")


def clicks_export(file: Path, workspace: Path = HERE) -> None:
    """Write the clicks of all objects to a CSV file.

    Example: rpl clicks export clicks.csv --workspace my-workspace

    Args:
        file: the CSV file to write; replaced when it is there.
        workspace: a folder made by `rpl build` or `rpl import`.
    """
    from rpl_data.files import write_text
    from rpl_data.pipeline.stages.clicks import clicks_table
    from rpl_data.workspace.workspace import Workspace

    write_text(file, clicks_table(Workspace(workspace)))


HELP = "Labelled pose, keypoint and mask datasets from RGB-D videos and a few clicks. Start with `rpl build`."
COMMANDS: dict[str, Any] = {
    "build": build_recipe,
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
    "drift": drift,
    "cut": cut,
    "solve": solve,
    "register": register,
    "surface": surface,
    "refine": refine,
    "segment": segment,
    "label": label,
    "export": export,
    "quality": quality,
    "truth": truth,
    "report": report,
}


if __name__ == "__main__":
    sys.exit(main())
