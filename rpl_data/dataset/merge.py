"""Several datasets become one: objects brought into one frame, images that they share taken once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from rpl_data.dataset.object_frames import (
    SameObject,
    joined_object,
    moved_annotation,
    same_object,
    stated_sigmas_m,
)
from rpl_data.dataset.same_images import ImageIndex
from rpl_data.dataset.source import Part, Source, parts_of, source_at
from rpl_data.dataset.written import Images, Spool, Written, finish, spooling
from rpl_data.export.split import FrameKey, SplitName
from rpl_data.json_arrays import Json
from rpl_data.types import DataError
from rpl_data.wording import counted


def merge_datasets(
    out: Path,
    sources: Sequence[Path],
    *,
    images: Images = "link",
    most_residual_mm: float | None = None,
) -> Written:
    """Merge datasets into the folder `out`.

    Objects are the same when their names are; the poses of later sources are converted into the object frame
    of the first that has the object (`object_frames`). An image that a later source shares with an earlier
    one is taken once, with the objects that either has labelled; an object that both have labelled keeps
    the earlier label. Scenes of one name but of other images get a number behind their name. Every frame
    keeps its split, but a scene with a test frame is wholly test.

    Args:
        most_residual_mm: by how much the keypoints of an object may differ between sources; three times
            what the labels state of themselves, when left out.

    Raises:
        DataError: less than two sources, one is damaged, or an object is not the same in two of them.
            `out` is then as it was.
    """
    if len(sources) < 2:
        raise DataError(f"a merge needs at least two datasets, got {len(sources)}")
    found = [source_at(path) for path in sources]
    if len({source.folder.resolve() for source in found}) < len(found):
        raise DataError("a dataset is named twice; name each source once")
    with spooling(out, found, images) as spool:
        merge = _Merge(spool, None if most_residual_mm is None else most_residual_mm / 1000)
        for source in found:
            merge.take(source)
        split_of, moved = _whole_test_scenes(spool, merge.tested)
        written = finish(
            spool,
            split_of.__getitem__,
            command="merge",
            options={"images": images, "most_residual_mm": most_residual_mm},
            sources=found,
            messages=[*merge.messages(), *moved],
        )
    return written


SAID = 5
"""Renamed scenes that a message lists."""


@dataclass
class _Merge:
    """The state of a merge.

    Attributes:
        sigmas_m: what the labels state about the keypoints of each object, by the first source that has it.
        owner: the source in whose frame an object is.
        index: the images of the sources before the present one.
        tested: scenes with a frame that a source tests on.
        twice: images that were there already, by source; doubled: labels dropped, since there was one.
    """

    spool: Spool
    most_residual_m: float | None
    sigmas_m: dict[str, Mapping[str, float]] = field(default_factory=dict)
    owner: dict[str, Source] = field(default_factory=dict)
    index: ImageIndex = field(default_factory=ImageIndex)
    tested: set[str] = field(default_factory=set)
    twice: Counter[str] = field(default_factory=Counter)
    doubled: Counter[str] = field(default_factory=Counter)
    lines: list[str] = field(default_factory=list)

    def take(self, source: Source) -> None:
        """Take all splits of a source."""
        before = set(self.spool.frames)
        parts = list(parts_of(source))  # all of them, since a scene may share images of one split only
        same = self._objects(source, parts)
        shared = {part.split: self._shared(source, part) for part in parts}
        scenes = self._scene_names(source, parts, shared)
        for part in parts:
            for image in part.images:
                own = [_converted(a, same, image) for a in part.annotations.get(image["id"], ())]
                partner = shared[part.split].get(image["id"])
                key = (scenes[image["scene"]], image["frame"])
                if partner is None:
                    self.spool.add(source, part.split, image | {"scene": key[0]}, own)
                else:
                    self._join(source, partner, own)
                    key = partner
                if part.split == "test":
                    self.tested.add(key[0])
        for key in self.spool.frames.keys() - before:
            self.index.add(key, self.spool.frames[key].file)

    def _scene_names(
        self, source: Source, parts: Sequence[Part], shared: Mapping[SplitName, Mapping[int, FrameKey]]
    ) -> dict[str, str]:
        """The name here of each scene of a source: that of one with the same images, or one of its own."""
        taken = {scene for scene, _ in self.spool.frames}
        names: dict[str, str] = {}
        renumbered: dict[str, str] = {}
        renamed: dict[str, str] = {}
        for part in parts:
            for image in part.images:
                scene, frame = shared[part.split].get(image["id"], (None, None))
                if scene is not None and frame == image["frame"]:
                    names.setdefault(image["scene"], scene)
                elif scene is not None:
                    renumbered[image["scene"]] = scene
        for scene in dict.fromkeys(image["scene"] for part in parts for image in part.images):
            if scene not in names:
                names[scene] = _free_name(scene, taken | set(names.values()))
                if names[scene] != scene:
                    renamed[scene] = names[scene]
            if scene in renumbered and names[scene] != renumbered[scene]:
                self.lines.append(
                    f"scene {scene} of {source.given} shows what scene {renumbered[scene]} shows, under "
                    "other frame numbers: keep both in one split (`rpl dataset split`)"
                )
        if renamed:
            first = sorted(renamed.items())[:SAID]
            pairs = ", ".join(f"{old} -> {new}" for old, new in first) + (
                ", ..." if len(renamed) > SAID else ""
            )
            self.lines.append(f"scenes of {source.given} whose names are taken have a new one: {pairs}")
        return names

    def _shared(self, source: Source, part: Part) -> dict[int, FrameKey]:
        """For each image that an earlier source has, too, the frame there."""
        pairs = ((image["id"], self.index.find(source.folder / image["file_name"])) for image in part.images)
        return {number: key for number, key in pairs if key is not None}

    def _join(self, source: Source, key: FrameKey, annotations: Sequence[Json]) -> None:
        """Add the objects that an image does not have yet."""
        names = {category["id"]: category["name"] for category, _ in self.spool.objects}
        there = set(self.spool.frames[key].objects)
        new = [each for each in annotations if names[each["category_id"]] not in there]
        self.spool.annotate(key, new)
        self.twice[source.given] += 1
        self.doubled[source.given] += len(annotations) - len(new)

    def _objects(self, source: Source, parts: Sequence[Part]) -> dict[int, tuple[int, SameObject | None]]:
        """By category id of the source: the id here, and how it is converted; None for a new object."""
        labels = [
            (annotation, image["cam_K"][0])
            for part in parts
            for image in part.images
            for annotation in part.annotations.get(image["id"], ())
            if not annotation.get("iscrowd")
        ]
        known = {category["name"]: row for row, (category, _) in enumerate(self.spool.objects)}
        ids: dict[int, tuple[int, SameObject | None]] = {}
        for entry in parts[0].objects:
            category = entry[0]
            name = category["name"]
            own = [(label, focal_px) for label, focal_px in labels if label["category_id"] == category["id"]]
            sigmas_m = stated_sigmas_m(category["keypoints"], own)
            if name not in known:
                self.spool.take_objects([entry], source)
                self.sigmas_m[name], self.owner[name] = sigmas_m, source
                ids[category["id"]] = (len(self.spool.objects), None)
                continue
            row = known[name]
            where = f"object {name} in {self.owner[name].given} and in {source.given}"
            same = same_object(
                self.spool.objects[row],
                entry,
                (self.sigmas_m[name], sigmas_m),
                most_residual_m=self.most_residual_m,
                where=where,
            )
            self.spool.objects[row], more = joined_object(self.spool.objects[row], entry, same)
            ids[category["id"]] = (row + 1, same)
            self.lines.append(_said(name, self.owner[name], source, same))
            self.lines += [f"{where}: {line}" for line in more]
        return ids

    def messages(self) -> list[str]:
        """What was found and done, for the user."""
        twice = [
            f"{counted(count, 'image')} of {given} were there already and are taken once, with the labels of "
            f"both; {counted(self.doubled[given], 'label')} of objects that were labelled already left out"
            for given, count in self.twice.items()
        ]
        return [*self.lines, *twice]


def _said(name: str, owner: Source, source: Source, same: SameObject) -> str:
    if same.unchanged:
        return f"{name}: the model of {source.given} is that of {owner.given}"
    return (
        f"{name}: poses of {source.given} are converted to the object frame of {owner.given} by "
        f"{same.shared} keypoints, which agree to {1000 * same.residual_m:.1f} mm (root mean square, at most "
        f"{1000 * same.most_m:.1f} mm; the labels state {1000 * same.expected_m:.1f} mm per axis); keypoints "
        "are projected anew from one model; mesh and grasp are those of the first"
    )


def _converted(annotation: Json, same: Mapping[int, tuple[int, SameObject | None]], image: Json) -> Json:
    number, how = same[annotation["category_id"]]
    moved = annotation if how is None else moved_annotation(annotation, how, image)
    return moved | {"category_id": number}


def _free_name(scene: str, taken: set[str]) -> str:
    """The name of a scene, or with the first number behind it that no scene has."""
    name, number = scene, 2
    while name in taken:
        name, number = f"{scene}-{number}", number + 1
    return name


def _whole_test_scenes(spool: Spool, test: set[str]) -> tuple[dict[FrameKey, SplitName], list[str]]:
    """The split of each frame, where a scene with a test frame is wholly test; and lines that say so."""
    splits = {key: kept.split for key, kept in spool.frames.items()}
    moved = Counter(key[0] for key, name in splits.items() if key[0] in test and name != "test")
    lines = [
        f"scene {scene}: {counted(count, 'image')} moved to test, since another source tests on this scene"
        for scene, count in sorted(moved.items())
    ]
    return {key: "test" if key[0] in test else name for key, name in splits.items()}, lines
