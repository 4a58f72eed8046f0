"""The command by which trained networks label scenes that nobody clicked."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from rpl_data.cli.building import HERE
from rpl_data.cli.programs import commands_module


def propose(
    keypoints: list[Path],
    detector: Path,
    workspace: Path = HERE,
    scenes: list[str] = [],  # noqa: B006 (never changed)
    frames: int = 24,
    threads: int | None = None,
) -> None:
    """Let trained networks place objects in scenes without clicks, and show where labels disagree with them.

    In each scene the networks look at some images. Where an object has no labels, the pose on which the
    images agree is one proposal; shape makes others, as for `rpl register --auto true`, and colours and free
    space decide. An object that they do not support is not placed: the message names the one click that would
    settle it. Where an object has labels, the report shows how far they lie from the networks' pose, and
    marks those that are farther off than the images disagree among themselves. Poses that look the same, by a
    symmetry that holds for the object (`rpl symmetry`), count as one.

    New recordings come in by the recipe: add them to its scenes and `rpl build` once, then propose, then
    `rpl build` again for labels and exports.

    Example: rpl propose '[runs/drill/best.ckpt, runs/cup/best.ckpt]' runs/detector/best.ckpt --workspace mine

    Args:
        keypoints: checkpoints of `rpl train keypoints`, one per object.
        detector: checkpoint of `rpl train detector` that knows these objects.
        workspace: a folder made by `rpl build`.
        scenes: names of the scenes to look at; all when left out.
        frames: images per scene to look at, spread over it.
        threads: processor threads of torch; None leaves the number to torch.
    """
    from rpl_data.cli.screen import Screen
    from rpl_data.pipeline.propose import Networks
    from rpl_data.pipeline.propose import propose as proposed
    from rpl_data.types import DataError
    from rpl_data.workspace.workspace import Workspace

    if frames < 1:
        raise DataError(f"--frames is {frames}; give 1 or more")
    programs = commands_module().removesuffix(".commands")
    import_module(f"{programs}.runs.program").use_threads(threads)
    models, look = import_module(f"{programs}.pose.looking").load_look(keypoints, detector)
    names = dict(zip(models, map(str, keypoints), strict=True))
    with Screen() as screen:
        for line in proposed(
            Workspace(workspace),
            Networks(models, names, look),
            scenes=scenes,
            frames=frames,
            tell=screen.tell,
        ):
            screen.console.print(line)
    print("`rpl build` labels what was placed; `rpl report --again true` shows where labels disagree")
