"""The command about symmetries of objects."""

from __future__ import annotations

from pathlib import Path

from rpl_data.cli.building import HERE


def symmetry(workspace: Path = HERE, object: str | None = None, confirm: str | None = None) -> None:
    """Find the turns after which an object looks the same, and keep what you confirm of them.

    Shape and print of the dense model are compared with themselves after turns about many axes. What is found
    is only proposed: a small mark, or a side that no camera saw, can make the difference. Confirmed
    symmetries go into the exports from now on (COCO, BOP's models_info.json). MSSD and MSPD of
    `rpl evaluate poses --bop` then allow for them, ADD, PCK and orientation with `--symmetric true`; ADD-S
    needs none. Training uses them with `rpl train keypoints --canonical true` or
    `KeypointDataset(canonical=True)` only.

    In a recipe: `objects: [{name: cup, symmetry: none}]`, or, with the numbers that this command shows,
    `symmetry: [{axis: [0, 0, 1], point_m: [0, 0, 0], turns: 2}]`; `turns: any` for a full rotation. What
    the recipe says takes precedence over this command.

    Example: rpl symmetry --workspace my-workspace --object bottle --confirm found

    Args:
        workspace: a folder made by `rpl build`.
        object: name of one object; all when left out.
        confirm: `found` = all that is proposed holds; `none` = nothing does; or numbers of the axes that
            hold, such as 1,3.
    """
    from rpl_data.pipeline.build import alone_in, context_of
    from rpl_data.pipeline.register import object_named
    from rpl_data.pipeline.symmetry import confirm_symmetry, find_object_symmetry, symmetry_lines
    from rpl_data.types import DataError
    from rpl_data.workspace.workspace import Workspace

    place = Workspace(workspace)
    context = context_of(place)
    if confirm is not None and object is None:
        raise DataError("--confirm needs --object: say whose symmetry it is")
    items = context.objects if object is None else [object_named(context, object)]
    with alone_in(place):
        for item in items:
            if confirm is None:
                record = find_object_symmetry(context, item.name)
            else:
                record = confirm_symmetry(context, item.name, confirm)
            print("\n".join(symmetry_lines(item, record)), flush=True)
    if confirm is not None:
        print("`rpl export` writes it")
