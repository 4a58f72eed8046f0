"""The commands about clicks: the annotation page, and clicks in and out as CSV files."""

from __future__ import annotations

from pathlib import Path

from rpl_data.cli.building import HERE, run_build


def annotate(
    workspace: Path,
    recipe: Path | None = None,
    root: Path | None = None,
    host: str = "127.0.0.1",
    port: int = 8017,
    folder: Path | None = None,
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
        port: where the page is served; workspaces that are opened from it get the next ports.
        folder: the page may open workspaces and recordings below this folder; when left out, those beside the
            workspace, and with a --host for other machines none.
    """
    from rpl_data.cli.annotate import address_of
    from rpl_data.cli.listening import listening
    from rpl_data.cli.opened import serve
    from rpl_data.pipeline.recipe_file import load_recipe

    address = address_of(host, port)
    if recipe is not None:
        run_build(load_recipe(recipe, root=root), workspace, "clicks", None)
    taken, address = listening(address)
    with taken:
        serve(
            workspace,
            address,
            taken,
            folder=folder,
            ready=lambda: print(f"open {address.url}\nend with Ctrl-C", flush=True),
        )


def clicks_import(file: Path, workspace: Path = HERE, proposed: bool = False, replace: bool = False) -> None:
    """Add the clicks of a CSV file; a click on the same keypoint in the same frame is moved.

    It says how many clicks were added, moved and removed, and how many stay as before.

    Example: rpl clicks import corrected.csv --workspace my-workspace

    Args:
        file: columns object,keypoint,scene,frame,u_px,v_px; a keypoint by name, or by
            number from 0; also `instance`, where a scene shows several of an object.
        workspace: a folder made by `rpl build` or `rpl import`.
        proposed: the clicks are a program's (`rpl predict poses --clicks`): what a person decided
            stays, and they only fill in keypoints that were neither clicked in that scene nor declared not
            visible there.
        replace: remove all other clicks of the objects in the file.
    """
    from rpl_data.pipeline.build import context_of
    from rpl_data.pipeline.stages.clicks import add_clicks
    from rpl_data.types import DataError
    from rpl_data.workspace.workspace import Workspace

    if proposed and replace:
        raise DataError("proposed clicks only fill gaps: give either --proposed or --replace")
    found = add_clicks(context_of(Workspace(workspace)), file, proposed=proposed, replaces=replace)
    for name, change in found.items():
        print(f"{name}: {change}")


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
