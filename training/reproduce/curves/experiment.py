"""Error curves: mean 3D error of the sparse model against the number of keypoints and of scenes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rpl_data.types import DataError

if TYPE_CHECKING:
    from rpl_data.pipeline.recipe import Recipe
    from rpl_data.workspace.workspace import Workspace

OBJECTS = ("drill", "bracket", "junction_box")
"""In the place of the paper's cut-out tool, electronic wrench and screw gun."""


def curves(
    out: Path = Path("runs/curves"),
    workspace: Path | None = None,
    objects: tuple[str, ...] = OBJECTS,
    scenes: int = 10,
    seeds: int = 20,
    click_noise_px: float = 2.0,
    workers: int | None = None,
) -> None:
    """Mean 3D error of sparse models against N_k (with N_s = 8) and against N_s (with N_k = 9).

    Each object is filmed once. Every seed clicks it anew, once per keypoint and scene, and draws its scenes.
    Landmarks are ordered: a smaller N_k takes the first of those of a larger one. Errors are strict
    (true correspondences after one rigid fit).

    Args:
        out: folder for curves.json, curves.html, two PNGs and the recordings.
        workspace: a twin that is already built; its objects are used instead of `objects`.
        objects: shapes of the twin.
        scenes: how many are filmed; N_s goes up to that.
        seeds: repetitions.
        click_noise_px: standard deviation of a click on each axis.
        workers: processes that render; one per core when left out.
    """
    from .page import write_curves
    from .resample import curves_of

    if workspace is not None:
        places = [_existing(workspace)]
    else:
        places = [_filmed(name, out / "workspaces" / name, scenes, workers) for name in objects]
    found = [c for place in places for c in curves_of(place, seeds=seeds, click_noise_px=click_noise_px)]
    path, text = write_curves(out, found, seeds=seeds, click_noise_px=click_noise_px)
    print(text)
    print(path)


def _existing(folder: Path) -> Workspace:
    from rpl_data.workspace.workspace import Workspace

    place = Workspace(folder)
    if not place.truth.exists():
        raise DataError(
            f"{folder} is no built twin: the curves click landmarks again and again, and need their truth"
        )
    return place


def _filmed(name: str, folder: Path, scenes: int, workers: int | None) -> Workspace:
    """Film one object: one frame every two seconds of a slow partial orbit, which is enough to click in."""
    from rpl_data.workspace.workspace import Workspace

    from ..building import build_and_tell

    place = Workspace(folder)
    build_and_tell(_recipe(name, scenes), place, until="import", workers=workers)
    return place


def _recipe(name: str, scenes: int) -> Recipe:
    from rpl_data.pipeline.recipe import Recipe
    from rpl_data.twin.spec import TwinSpec

    spec = TwinSpec(objects=(name,), scenes=scenes, seconds=16.0, keep_hz=0.5, clicks_per_keypoint=1)
    return Recipe(name=f"curves_{name}", twin=spec)
