"""The commands about labels that were corrected with another program."""

from __future__ import annotations

from pathlib import Path

from rpl_data.cli.building import HERE


def labels_import(file: Path, workspace: Path = HERE) -> None:
    """Keep what was changed in a file of export/coco with another program, and say what that is.

    Taken are changed masks (polygons or run lengths; the box follows), keypoints and their visibility,
    deleted instances, and `iscrowd`. Images that the file lacks stay as they are. The labels themselves do
    not change: every export from now on applies the corrections and marks those annotations with
    `corrected: true`. Importing a later version of the file replaces what was kept of its images.

    Example: rpl labels import corrected.json --workspace my-workspace

    Args:
        file: train.json, val.json or test.json of export/coco, edited; `scene` and `frame` of its images may
            be missing if the file names are there.
        workspace: a folder made by `rpl build`.
    """
    from rpl_data.pipeline.build import alone_in, context_of
    from rpl_data.pipeline.corrections import import_corrections
    from rpl_data.workspace.workspace import Workspace

    place = Workspace(workspace)
    context = context_of(place)
    with alone_in(place):
        print("\n".join(import_corrections(context, file)))
    print("`rpl export` applies the corrections; `rpl labels forget` drops them")


def labels_forget(workspace: Path = HERE) -> None:
    """Drop all corrections that were imported; the next export has the computed labels again.

    Example: rpl labels forget --workspace my-workspace

    Args:
        workspace: a folder made by `rpl build`.
    """
    from rpl_data.pipeline.build import alone_in, context_of
    from rpl_data.pipeline.corrections import forget_corrections
    from rpl_data.wording import counted
    from rpl_data.workspace.workspace import Workspace

    place = Workspace(workspace)
    context = context_of(place)
    with alone_in(place):
        print(f"{counted(forget_corrections(context), 'correction')} dropped")
