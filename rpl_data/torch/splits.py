"""Find the file of a split in an export, or say why there is none."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rpl_data.files import decoding, read_json
from rpl_data.json_arrays import text
from rpl_data.types import DataError
from rpl_data.wording import counted

FEWEST_SCENES = 3
"""Fewest scenes for a test split: it takes whole scenes, and two must remain for training."""


def split_file(export: str | Path, split: str | None) -> Path:
    """Find the COCO file that a user names by a folder and a split, or by the file itself.

    Args:
        export: the folder of an export (my-workspace/export/coco) or one of its JSON files.
        split: train, val or test, when `export` is a folder; None for a file.

    Raises:
        DataError: there is no such folder, file or split; the message says why and what to do.
    """
    path = Path(export).expanduser()
    if path.is_file():
        if split is not None:
            raise DataError(
                f"{path} is a file, not a folder with splits; give its folder, or leave split={split!r} out"
            )
        return path
    if not path.is_dir():
        if split is None and path.suffix == ".json" and path.parent.is_dir():
            return split_file(path.parent, path.stem)  # raises the error that says why it is missing
        raise DataError(f"{path} does not exist; make it with `rpl build` or `rpl export`")
    there = [name for name in ("train", "val", "test") if (path / f"{name}.json").exists()]
    if not there:
        inner = path / "export" / "coco"
        hint = f"give {inner}" if inner.exists() else "make it with `rpl build` or `rpl export`"
        raise DataError(f"{path} holds no exported dataset (train.json is missing); {hint}")
    if split is None:
        raise DataError(f"{path} is a folder; say which split, one of {', '.join(there)}: split={there[0]!r}")
    if split not in there:
        raise DataError(f"{path} has no {split} split{_why(path, split, there)}. It has {', '.join(there)}")
    return path / f"{split}.json"


def refuse_no_labels(labelled: int, coco_json: Path) -> None:
    """Raise a DataError where the images of a training split show no object."""
    if not labelled:
        raise DataError(
            f"{coco_json} shows no object, so there is nothing to learn; label some frames, and export again"
        )


def _why(folder: Path, split: str, there: list[str]) -> str:
    """The reason why a split was not exported, as far as the other files show it."""
    if split in ("val", "test") and _rendered(folder / "train.json"):
        return (
            ": `rpl synthesize` renders images to train on; take val and test of export/coco, or render with "
            "--mix true, which puts them beside the rendered images"
        )
    if split == "test":
        scenes = scenes_of(folder, there)
        if len(scenes) < FEWEST_SCENES:
            found = counted(len(scenes), "scene")
            return (
                f": it takes whole scenes that training never saw, and the labels come from only {found}; "
                f"record at least {FEWEST_SCENES}"
            )
        return ": the recipe asked for no test scene (`split: {test_scenes: 1}`), or none could be spared"
    if split == "val":
        return ": the recipe asked for none (`split: {val_fraction: 0.1}`), or there were too few frames"
    return "" if split == "train" else ": the names are train, val and test"


def _rendered(train_json: Path) -> bool:
    """Whether all images were rendered by `rpl synthesize`."""
    if not train_json.exists():
        return False
    with decoding(train_json, "export the dataset again with `rpl export`"):
        images = read_json(train_json)["images"]
        return bool(images) and all(image.get("origin") == "synthetic" for image in images)


def scenes_of(folder: Path, splits: Sequence[str]) -> set[str]:
    """Names of the scenes that the images of these splits come from; a split may be lacking."""
    scenes: set[str] = set()
    for file in (folder / f"{name}.json" for name in splits):
        if file.exists():
            with decoding(file, "export the dataset again with `rpl export`"):
                scenes |= {text(image["scene"]) for image in read_json(file)["images"]}
    return scenes
