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

from rpl_data.cli.building import HERE, run_build, workspace_for  # noqa: E402
from rpl_data.cli.clicks import annotate, clicks_export, clicks_import  # noqa: E402
from rpl_data.cli.datasets import (  # noqa: E402
    dataset_convert,
    dataset_filter,
    dataset_merge,
    dataset_split,
    dataset_stats,
)
from rpl_data.cli.first import init  # noqa: E402
from rpl_data.cli.labels import labels_forget, labels_import  # noqa: E402
from rpl_data.cli.machine import demo, doctor  # noqa: E402
from rpl_data.cli.programs import PROGRAMS, run_program  # noqa: E402
from rpl_data.cli.propose import propose  # noqa: E402
from rpl_data.cli.recordings import capture, check, import_, truth  # noqa: E402
from rpl_data.cli.stages import (  # noqa: E402
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
from rpl_data.cli.status import status  # noqa: E402
from rpl_data.cli.symmetry import symmetry  # noqa: E402
from rpl_data.cli.synthesize import synthesize  # noqa: E402
from rpl_data.types import DataError, UnsureError  # noqa: E402


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; 0 when all is well, 1 with one line on stderr when the user can mend it.

    3, with one line, when `rpl register --auto` is not sure.
    """
    given = sys.argv[1:] if arguments is None else arguments
    try:
        from rpl_data.command_line import run

        if given and given[0] in PROGRAMS:
            return run_program(given)
        run(COMMANDS | PROGRAMS, given, program="rpl", description=HELP)
        sys.stdout.flush()  # here, where a disk that is full can be said
    except DataError as error:
        print(f"rpl: {error}", file=sys.stderr)
        return 3 if isinstance(error, UnsureError) else 1
    except KeyboardInterrupt:
        print("rpl: interrupted; run the same command again and it goes on from here", file=sys.stderr)
        return 130
    except BrokenPipeError:  # whoever read our output has gone, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:  # a fault of ours: the last net, so that nobody is shown a page of code
        from rpl_data.cli.faults import reported
        from rpl_data.cli.installed import missing_package

        missing = missing_package(error) if isinstance(error, ModuleNotFoundError) else None
        print(f"rpl: {missing or reported(error, given)}", file=sys.stderr)
        return 1
    return 0


# Not called `build`: the parser would look for it in rpl_data, which then imports everything.
def build_recipe(
    recipe: Path,
    workspace: Path | None = None,
    root: Path | None = None,
    workers: int | None = None,
    again: str | None = None,
    dask: str | None = None,
    keep_going: bool = False,
) -> None:
    """Make everything a recipe asks for; only what is out of date is run.

    Stages, in order: twin, import, clicks, track, drift, cut, solve, surface, refine, segment, label,
    export, quality, report. Interrupt it whenever you like: run it again and it goes on from there.
    `method: paper` in the recipe makes every stage do what the paper does, as a baseline.

    Example: rpl build my.yaml --root my-recording --workspace my-workspace

    The smallest recipe, for a recording made with `rpl capture` and clicks made with `rpl annotate`:

      name: cube
      scenes: [{path: my-recording}]
      objects: [{name: cube, keypoints: 8}]

    The workspace's own recipe.yaml lists every field with its value.

    Args:
        recipe: the YAML file.
        workspace: folder for everything that is made; when left out, the current one if it is a workspace,
            else workspaces/<name of the file>.
        root: where the relative paths of the recipe start; the recipe's own folder when left out.
        workers: number of processes, which work on scenes side by side; as many as there are cores when left
            out, 1 = only this one.
        again: a stage to run again although nothing it depends on has changed, or `all`.
        dask: a Dask cluster that does the work instead: `tcp://HOST:PORT` of its scheduler, or `local:N`. Its
            workers must see recordings and workspace at the same paths.
        keep_going: where a step fails in one scene, or a recording cannot be read now, leave that out and
            make the rest; what failed is listed at the end, with exit status 1.
    """
    from rpl_data.pipeline.recipe_file import load_recipe

    run_build(
        load_recipe(recipe, root=root),
        workspace or workspace_for(recipe),
        None,
        again,
        workers,
        dask=dask,
        keep_going=keep_going,
    )


def register(object: str, scene: str, workspace: Path = HERE, auto: bool = False) -> None:
    """Place a known object in one more scene, from three clicks there or more; its model stays as it is.

    It states the expected error of the keypoints, in mm and px, and which further click would help most.
    Where the object has a dense model, it is then aligned to the depth and colours of the scene; the pose
    from the clicks stays where held-out parts of the surface do not agree better afterwards.

    With `--auto` no click is needed: shape proposes poses for what stands on the table, and colours and free
    space verify them. Where that leaves a doubt, nothing is written, the exit status is 3, and the message
    names the one click that would settle it; make that click, and run the same command again.

    Example: rpl register cube 04 --workspace my-workspace

    Args:
        object: name of the object.
        scene: name of the scene, which must be in the recordings of the recipe; its clicks must be in the
            workspace.
        workspace: a folder made by `rpl build` or `rpl import`.
        auto: find the object without clicks; it needs a coloured dense model, as `rpl build` makes it.
    """
    from rpl_data.cli.screen import Screen
    from rpl_data.pipeline.automatic import find_step
    from rpl_data.pipeline.build import context_of, recipe_of, run_step
    from rpl_data.pipeline.register import object_named, register_step
    from rpl_data.workspace.workspace import Workspace

    place = Workspace(workspace)
    object_named(context_of(place), object)  # said before anything is brought up to date for it
    work = find_step if auto else register_step
    with Screen() as screen:
        entry = run_step(
            recipe_of(place),
            place,
            lambda context, advance: work(context, object, scene, advance),
            title=("register", object),
            tell=screen.tell,
        )
    print("\n".join(entry.outcome.messages))


def completion(shell: Literal["bash", "zsh"]) -> None:
    """Print a script by which the shell completes commands and options.

    Put the line of the example into ~/.bashrc (with `zsh`, into ~/.zshrc); it takes effect in the next shell.

    Example: eval "$(rpl completion bash)"

    Args:
        shell: the shell whose language it is in.
    """
    from rpl_data.cli.completion import completion_script

    print(completion_script(COMMANDS, shell))


HELP = "Labelled pose, keypoint and mask datasets from RGB-D videos and a few clicks. Start with `rpl init`."
COMMANDS: dict[str, Any] = {
    "build": build_recipe,
    "status": status,
    "demo": demo,
    "doctor": doctor,
    "capture": capture,
    "check": check,
    "init": init,
    "import": import_,
    "track": track,
    "annotate": annotate,
    "clicks": {
        "_help": "Clicks in and out as CSV files.",
        "import": clicks_import,
        "export": clicks_export,
    },
    "labels": {
        "_help": "Labels that were corrected with another program.",
        "import": labels_import,
        "forget": labels_forget,
    },
    "dataset": {
        "_help": "Exported datasets, merged, filtered, split anew, converted and counted.",
        "merge": dataset_merge,
        "filter": dataset_filter,
        "split": dataset_split,
        "convert": dataset_convert,
        "stats": dataset_stats,
    },
    "drift": drift,
    "cut": cut,
    "solve": solve,
    "register": register,
    "propose": propose,
    "surface": surface,
    "refine": refine,
    "segment": segment,
    "label": label,
    "symmetry": symmetry,
    "export": export,
    "synthesize": synthesize,
    "quality": quality,
    "truth": truth,
    "report": report,
    "completion": completion,
}


if __name__ == "__main__":
    sys.exit(main())
