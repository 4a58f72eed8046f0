"""A dataset that is read: its splits one after the other, and the hash of its content."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from rpl_data.export.split import SplitName
from rpl_data.files import decoding, file_hash, read_json
from rpl_data.formats.datasets.coco_parts import ByImage, read_packed
from rpl_data.json_arrays import Json, mapping, optional, text
from rpl_data.types import DataError
from rpl_data.untrusted.names import checked_name
from rpl_data.workspace.workspace import Workspace

SPLITS: tuple[SplitName, ...] = ("train", "val", "test")
VERSION_FILE = "dataset.json"
"""Beside the splits: what a dataset was made of, how, and the hash of its content."""


@dataclass(frozen=True)
class Source:
    """A dataset on the disk.

    Attributes:
        given: the path as the user wrote it.
        folder: the COCO folder itself.
    """

    given: str
    folder: Path

    @property
    def splits(self) -> list[SplitName]:
        """The splits that the folder has."""
        return [name for name in SPLITS if (self.folder / f"{name}.json").exists()]


@dataclass(frozen=True)
class Part:
    """A split of a dataset, in memory.

    Attributes:
        objects: for each object its entry in `categories` and its entry in `rpl.objects`.
        annotations: by image id, those that stand for a crowd included; parsed when they are looked at, so a
            change to one is lost.
    """

    split: SplitName
    objects: list[tuple[Json, Json]]
    images: list[Json]
    annotations: Mapping[int, list[Json]]


def source_at(path: Path) -> Source:
    """Find the COCO folder of a workspace, or take the folder itself.

    Raises:
        DataError: there is none.
    """
    exported = Workspace(path).export("coco")
    source = Source(str(path), exported if exported.is_dir() else path)
    if not source.splits:
        raise DataError(
            f"{path} holds no dataset: expected {', '.join(f'{name}.json' for name in SPLITS)} in it, or a "
            "workspace with export/coco; run `rpl export` there first"
        )
    return source


def parts_of(source: Source) -> Iterator[Part]:
    """Read the splits; one is in memory at a time.

    Raises:
        DataError: a file is damaged or names what lies outside the dataset, or the splits disagree about
            their objects.
    """
    first: list[tuple[Json, Json]] | None = None
    for name in source.splits:
        data = read_packed(source.folder / f"{name}.json")
        _check_names(data, source.folder / f"{name}.json")
        described = {item["category_id"]: item for item in data["rpl"]["objects"]}
        objects = [(each, described[each["id"]]) for each in sorted(data["categories"], key=_by_id)]
        if first is not None and objects != first:
            raise DataError(
                f"{source.folder}: {name}.json describes other objects than {source.splits[0]}.json; export "
                "the dataset again"
            )
        first = objects
        by_image = ByImage(data["annotations"], data.get("crowds", ()))
        yield Part(name, objects, list(data["images"]), by_image)


def _check_names(data: Json, file: Path) -> None:
    """DataError where a name leads out of the dataset's folder, or out of one that is written of it."""
    for category in data["categories"]:
        checked_name(category["name"], "object", where=str(file))
    named = [item["mesh"] for item in data["rpl"]["objects"]]
    for image in data["images"]:
        checked_name(image["scene"], "scene", where=f"{file}: image {image['id']}")
        named += [image["file_name"], image["depth_file_name"]]
    for name in filter(None, named):
        path = PurePosixPath(name)
        if path.is_absolute() or ".." in path.parts:
            raise DataError(
                f"{file}: {name!r:.80} lies outside the dataset; expected names relative to its folder; "
                "export the dataset again"
            )


def _by_id(category: Json) -> int:
    number: int = category["id"]
    return number


def content_hash(folder: Path) -> str:
    """SHA-256 of a dataset: the splits byte for byte, all other files by name and size.

    Images are not read: 100,000 of them would take minutes. An image replaced by one of the same size is
    therefore not noticed.
    """
    digest = hashlib.sha256()
    for name in SPLITS:
        path = folder / f"{name}.json"
        if path.exists():
            digest.update(f"{name} {file_hash(path)}\n".encode())
    for kind in ("depth", "images", "meshes"):
        for path in sorted((folder / kind).rglob("*")):
            if path.is_file():
                line = f"{path.relative_to(folder).as_posix()} {path.stat().st_size}\n"
                digest.update(line.encode())
    return f"sha256:{digest.hexdigest()}"


def recorded_hash(folder: Path) -> str | None:
    """The hash in the version file of a dataset; None where there is none, as in other programs' files.

    Raises:
        DataError: the file cannot be read.
    """
    path = folder / VERSION_FILE
    if not path.exists():
        return None
    with decoding(path, "repair it, or remove it"):
        return optional(text)(mapping(read_json(path)).get("content_hash"))
