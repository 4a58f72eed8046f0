"""A dataset that is written: built under a temporary name, with its version file, renamed when complete."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Literal

from rpl_data.dataset.source import SPLITS, VERSION_FILE, Source, content_hash, recorded_hash
from rpl_data.export.checksums import edited_files
from rpl_data.export.folder import link, replacing
from rpl_data.export.split import FrameKey, SplitName
from rpl_data.files import write_json
from rpl_data.formats.datasets.coco_entries import writing_entries
from rpl_data.json_arrays import Json
from rpl_data.types import DataError
from rpl_data.version import installed_version
from rpl_data.wording import counted

Images = Literal["link", "copy"]
"""How images come into a dataset: linked where the file system can, or copied."""


@dataclass(frozen=True)
class Written:
    """Counts and messages about a dataset that was written.

    Attributes:
        images, annotations: how many, per split.
        messages: lines for the user.
        content_hash: as in the version file.
    """

    images: Mapping[SplitName, int]
    annotations: Mapping[SplitName, int]
    messages: tuple[str, ...]
    content_hash: str

    def lines(self, out: Path) -> list[str]:
        """All of it in words, for the terminal; `out` is the folder that was written."""
        splits = [
            f"{out / name}.json: {counted(count, 'image')}, {counted(self.annotations[name], 'annotation')}"
            for name, count in self.images.items()
        ]
        return [*splits, *(f"    {line}" for line in (*self.messages, self.content_hash))]


@dataclass
class Kept:
    """What is remembered of an image that was taken: all but its pixels and annotations.

    Attributes:
        split: where it goes.
        objects: names of the objects that are annotated in it, other than as to be ignored (`iscrowd`).
        file: the image file it was taken from.
    """

    image_id: int
    split: SplitName
    objects: set[str]
    file: Path


@dataclass
class Spool:
    """Takes images with their annotations, one by one, and writes them to the splits at the end.

    Which split a frame goes to may depend on all frames, so entries wait in a temporary file.
    """

    building: Path
    file: IO[str]
    how: Images
    frames: dict[FrameKey, Kept] = field(default_factory=dict)
    objects: list[tuple[Json, Json]] = field(default_factory=list)
    annotations: int = 0

    def add(self, source: Source, split: SplitName, image: Json, annotations: Sequence[Json]) -> None:
        """Take an image; `scene` and `frame` name it. Its files are linked or copied under those names."""
        key = (image["scene"], image["frame"])
        if key in self.frames:
            raise DataError(
                f"{source.given}: scene {key[0]} has frame {key[1]} twice, of different images; expected one "
                "image per frame. Filter one of the sources to other scenes"
            )
        file = source.folder / image["file_name"]
        entry = dict(image, id=len(self.frames) + 1)
        for name, folder in (("file_name", "images"), ("depth_file_name", "depth")):
            if image.get(name) is not None:
                entry[name] = f"{folder}/{key[0]}/{key[1]:06d}{Path(image[name]).suffix}"
                self.take_file(source.folder / image[name], entry[name])
        self.frames[key] = Kept(entry["id"], split, set(), file)
        self.annotate(key, annotations, entry)

    def annotate(self, key: FrameKey, annotations: Sequence[Json], image: Json | None = None) -> None:
        """Write annotations of an image that was taken; their ids are numbered anew."""
        kept = self.frames[key]
        names = {category["id"]: category["name"] for category, _ in self.objects}
        renumbered = []
        for annotation in annotations:
            self.annotations += 1
            renumbered.append(annotation | {"id": self.annotations, "image_id": kept.image_id})
            if not annotation.get("iscrowd"):
                kept.objects.add(names[annotation["category_id"]])
        self.file.write(json.dumps([key, image, renumbered], allow_nan=False) + "\n")

    def take_file(self, file: Path, name: str) -> None:
        """Link or copy a file into the dataset."""
        target = self.building / name
        if self.how == "link":
            link(file, target)
        else:
            target.parent.mkdir(parents=True, exist_ok=True)
            _copy(file, target)

    def take_objects(self, objects: Sequence[tuple[Json, Json]], source: Source) -> None:
        """Add objects, numbered on; their meshes come along."""
        for category, described in objects:
            number, mesh = len(self.objects) + 1, described["mesh"]
            if mesh is not None:
                name = f"meshes/{category['name']}{Path(mesh).suffix}"
                self.take_file(source.folder / mesh, name)
                described = described | {"mesh": name}
            self.objects.append((category | {"id": number}, described | {"category_id": number}))


def _copy(file: Path, target: Path) -> None:
    if not file.is_file():
        raise DataError(f"{file} is missing; put it back or export the dataset again")
    shutil.copyfile(file, target)


@contextmanager
def spooling(out: Path, sources: Sequence[Source], how: Images) -> Iterator[Spool]:
    """Yield a spool whose folder appears as `out` when the block ends well.

    Raises:
        DataError: `out` is one of the sources, or a folder that is not replaced: no dataset of ours, or one
            that was edited since it was written.
    """
    _check_target(out, sources)
    with replacing(out) as building, tempfile.TemporaryFile("w+", dir=building, encoding="utf-8") as file:
        yield Spool(building, file, how)


def refuse_overlap(out: Path, sources: Sequence[Source]) -> None:
    """DataError where a dataset would be written over one that it is made of, into it or around it."""
    for source in sources:
        inner, outer = out.resolve(), source.folder.resolve()
        if inner == outer or inner in outer.parents or outer in inner.parents:
            raise DataError(
                f"{out} and {source.given} are the same folder, or one lies in the other; name another"
            )


def _check_target(out: Path, sources: Sequence[Source]) -> None:
    refuse_overlap(out, sources)
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return
    recorded = recorded_hash(out)
    if recorded is None:
        raise DataError(
            f"{out} exists and is no dataset that `rpl dataset` wrote (it has no {VERSION_FILE} of it), so "
            "it is not replaced; name another folder, or remove it"
        )
    edited = edited_files(out)
    if edited or content_hash(out) != recorded:
        named = f"see {edited[0]}" if edited else f"its content is not that of {VERSION_FILE}"
        raise DataError(
            f"{out} was edited since `rpl dataset` wrote it ({named}), so it is not replaced; name another "
            "folder, or remove it"
        )


def finish(
    spool: Spool,
    splits: Callable[[FrameKey], SplitName],
    *,
    command: str,
    options: Json,
    sources: Sequence[Source],
    messages: Sequence[str],
) -> Written:
    """Write the splits and the version file of a dataset.

    Args:
        splits: the split of each frame.
        command, options: how it is made; said in the version file.
    """
    if not spool.frames:
        raise DataError(f"nothing is left: no image passes; {command} with less strict options")
    chosen = {key: splits(key) for key in spool.frames}
    images, annotations = Counter(chosen.values()), Counter[SplitName]()
    names: list[SplitName] = [name for name in SPLITS if images[name]]
    top = _top(spool.objects)
    spool.file.seek(0)
    with ExitStack() as stack:
        writers = {n: stack.enter_context(writing_entries(spool.building / f"{n}.json", top)) for n in names}
        for line in spool.file:
            key, image, found = json.loads(line)
            name = chosen[key[0], key[1]]
            annotations[name] += len(found)
            writers[name].add(image, found)
    digest = content_hash(spool.building)
    version = {
        "content_hash": digest,
        "hashed": "the splits byte for byte, all other files by name and size",
        "made_by": f"rpl-data {installed_version()}",
        "command": command,
        "options": options,
        "sources": [{"path": s.given, "content_hash": content_hash(s.folder)} for s in sources],
        "images": {name: images[name] for name in names},
        "annotations": {name: annotations[name] for name in names},
        "messages": list(messages),
    }
    write_json(spool.building / VERSION_FILE, version)
    return Written(version["images"], version["annotations"], tuple(messages), digest)  # type: ignore[arg-type]


def _top(objects: Sequence[tuple[Json, Json]]) -> Json:
    """Everything of a file but its images and annotations."""
    return {
        "info": {"description": "made by rpl-data", "version": "1.0"},
        "licenses": [],
        "categories": [category for category, _ in objects],
        "rpl": {"version": installed_version(), "objects": [described for _, described in objects]},
    }
