"""The command that renders new views of labelled objects."""

from __future__ import annotations

from pathlib import Path

from rpl_data.cli.building import HERE


def synthesize(
    workspace: Path = HERE,
    count: int = 1000,
    out: Path | None = None,
    objects: tuple[str, ...] | None = None,
    width: int | None = None,
    backgrounds: Path | None = None,
    mix: bool = False,
    seed: int = 0,
    again: bool = False,
) -> None:
    """Render new images of the labelled objects, from their own meshes, for training.

    Meshes, colours, light, backgrounds and noise are all made of the training scenes of export/coco: nothing
    of a test scene enters but by the keypoints and poses, which all scenes were solved for together. Objects
    stand on the recorded tables as they did, turned anew, or are shown from
    sides that the recordings lack. What no training scene saw is never shown. The labels are exact.

    The folder, export/synthetic of the workspace when --out is left out, is a COCO export like export/coco;
    its images say `"origin": "synthetic"`. Interrupt it whenever you like: the same command goes on.

    Example: rpl synthesize --workspace my-workspace --count 2000 --mix true

    Args:
        workspace: a folder made by `rpl build`.
        count: images to render; 0 only prepares what a training with `--synthetic` renders from, and removes
            images that were rendered into the folder before.
        out: folder to write; it is replaced only if this command wrote it.
        objects: only these: '[cup, drill]'.
        width: width of the images in pixels; that of the recordings when left out.
        backgrounds: folder of pictures to put behind the objects, in place of the recorded tables; they are
            stretched to the size of the images.
        mix: put the recorded training images beside the rendered ones, and val and test as they are.
        seed: of everything that is drawn at random; the same seed gives the same images.
        again: make meshes, colours and backgrounds anew, though nothing they depend on has changed.
    """
    from rpl_data.cli.screen import Screen
    from rpl_data.pipeline.build import alone_in, recipe_of
    from rpl_data.pipeline.progress import Progress
    from rpl_data.pipeline.synthesis.run import synthesize_workspace
    from rpl_data.workspace.workspace import Workspace

    place = Workspace(workspace)
    recipe_of(place)  # says that it is no workspace, before a lock is left there
    with Screen() as screen, alone_in(place):
        folder, lines = synthesize_workspace(
            place,
            out,
            count=count,
            objects=objects,
            width_px=width,
            seed=seed,
            backgrounds=backgrounds,
            mix=mix,
            again=again,
            tell=screen.console.print,
            advance=lambda done, total: screen.tell(Progress("render", "images", "runs", done, total)),
        )
    print(f"{folder}: {folder / 'train.json'}")
    print("\n".join(f"    {line}" for line in lines))
