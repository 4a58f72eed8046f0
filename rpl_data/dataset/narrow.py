"""A dataset made smaller, or split anew."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from rpl_data.dataset.source import Part, Source, parts_of, source_at
from rpl_data.dataset.written import Images, Spool, Written, finish, spooling
from rpl_data.export.split import SplitRule, choose_splits
from rpl_data.json_arrays import Json
from rpl_data.types import DataError
from rpl_data.wording import counted


@dataclass(frozen=True)
class Wanted:
    """What passes a filter. What is left out does not restrict.

    Attributes:
        objects: only these, and images that show one of them.
        scenes: only images of these.
        min_visibility: an instance with a smaller `visib_fract` is marked as to be ignored (`iscrowd`), since
            it is in the image all the same; an image with no other instance is left out.
        min_quality: an image is left out when a label in it has a lower quality, as `rpl export` does it.
        rate_hz: images per second of recording, in each scene.
    """

    objects: tuple[str, ...] | None = None
    scenes: tuple[str, ...] | None = None
    min_visibility: float = 0.0
    min_quality: float = 0.0
    rate_hz: float | None = None

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name in ("min_visibility", "min_quality"):
            if not 0 <= getattr(self, name) <= 1:
                raise DataError(f"{name} must be 0 to 1, got {getattr(self, name)}")
        if self.rate_hz is not None and not self.rate_hz > 0:
            raise DataError(f"the rate must be a positive number of images per second, got {self.rate_hz}")


def filter_dataset(out: Path, source: Path, wanted: Wanted, *, images: Images = "link") -> Written:
    """Write what passes a filter into the folder `out`; every image keeps its split.

    Raises:
        DataError: nothing passes, or an object or scene is not in the dataset.
    """
    found = source_at(source)
    with spooling(out, [found], images) as spool:
        dropped: Counter[str] = Counter()
        seen: Counter[str] = Counter()
        parts = list(parts_of(found))
        in_time = _in_time(parts, wanted)
        for part in parts:
            ids = _chosen_objects(spool, found, part, wanted.objects)
            for image in part.images:
                seen[image["scene"]] += 1
                labels = part.annotations.get(image["id"], ())
                own = [
                    label | {"category_id": ids[label["category_id"]]}
                    for label in labels
                    if label["category_id"] in ids
                ]
                why = _refusal(image, own, wanted, in_time)
                if why is None:
                    spool.add(found, part.split, image, [_ignored(label, wanted, dropped) for label in own])
                else:
                    dropped[why] += 1
        _refuse_unknown("scene", wanted.scenes, seen)
        lines = [
            f"left out: {counted(count, 'image')} {why}" for why, count in dropped.items() if why != IGNORED
        ]
        if dropped[IGNORED]:
            lines.append(
                f"{counted(dropped[IGNORED], 'instance')} of which less than {wanted.min_visibility:g} is "
                "visible: marked as to be ignored (`iscrowd`)"
            )
        return finish(
            spool,
            lambda key: spool.frames[key].split,
            command="filter",
            options={"images": images} | {key: value for key, value in asdict(wanted).items() if value},
            sources=[found],
            messages=lines,
        )


IGNORED = "ignored"


def _chosen_objects(
    spool: Spool, source: Source, part: Part, wanted: Collection[str] | None
) -> dict[int, int]:
    """The ids of the chosen objects, numbered anew, by their ids in the source."""
    names = [category["name"] for category, _ in part.objects]
    _refuse_unknown("object", wanted, names)
    chosen = [entry for entry in part.objects if wanted is None or entry[0]["name"] in wanted]
    if not spool.objects:
        spool.take_objects(chosen, source)
    return {category["id"]: number for number, (category, _) in enumerate(chosen, start=1)}


def _refuse_unknown(what: str, wanted: Collection[str] | None, known: Collection[str]) -> None:
    unknown = sorted(set(wanted or ()) - set(known))
    if unknown:
        raise DataError(
            f"there is no {what} {', '.join(unknown)} in the dataset; it has {', '.join(sorted(known))}"
        )


def _in_time(parts: Sequence[Part], wanted: Wanted) -> set[tuple[str, int]] | None:
    """The frames that a rate keeps: the first of every period, as `label: {rate}` does it; None = all."""
    if wanted.rate_hz is None:
        return None
    first: dict[tuple[str, int], tuple[float, int]] = {}
    times = sorted((i["scene"], i["timestamp_s"], i["frame"]) for part in parts for i in part.images)
    start: dict[str, float] = {}
    for scene, time_s, frame in times:
        # 5 % of a period absorbs the jitter of timestamps without letting the schedule drift.
        period = int((time_s - start.setdefault(scene, time_s)) * wanted.rate_hz + 0.05)
        first.setdefault((scene, period), (time_s, frame))
    return {(scene, frame) for (scene, _), (_, frame) in first.items()}


def _refusal(
    image: Json, labels: Sequence[Json], wanted: Wanted, in_time: set[tuple[str, int]] | None
) -> str | None:
    """Why an image does not pass; None when it does."""
    instances = [label for label in labels if not label.get("iscrowd")]
    if wanted.scenes is not None and image["scene"] not in wanted.scenes:
        return "of other scenes"
    if in_time is not None and (image["scene"], image["frame"]) not in in_time:
        return "between those that the rate keeps"
    if wanted.objects is not None and not instances:
        return "without the objects"
    if any(label["quality"] < wanted.min_quality for label in instances):
        return f"with a label of a quality below {wanted.min_quality:g}"
    if instances and all(label["visib_fract"] < wanted.min_visibility for label in instances):
        return f"where less than {wanted.min_visibility:g} of each object is visible"
    return None


def _ignored(label: Json, wanted: Wanted, dropped: Counter[str]) -> Json:
    """A label, marked as to be ignored where too little of the object is visible."""
    if label.get("iscrowd") or label["visib_fract"] >= wanted.min_visibility:
        return label
    dropped[IGNORED] += 1
    return label | {"iscrowd": 1}


def split_dataset(out: Path, source: Path, rule: SplitRule, *, images: Images = "link") -> Written:
    """Write a dataset into the folder `out`, split anew by the rule that `rpl export` uses.

    Raises:
        DataError: a test scene that does not exist, or a fraction outside 0 to 1.
    """
    found = source_at(source)
    with spooling(out, [found], images) as spool:
        for part in parts_of(found):
            _chosen_objects(spool, found, part, None)
            for image in part.images:
                spool.add(found, part.split, image, part.annotations.get(image["id"], ()))
        frames = {key: frozenset(kept.objects) for key, kept in sorted(spool.frames.items())}
        splits, lines = choose_splits(frames, rule)
        return finish(
            spool,
            splits.__getitem__,
            command="split",
            options={"images": images, **asdict(rule)},
            sources=[found],
            messages=lines,
        )
