"""The first recipe of a recording: its YAML text, with what the doctor is sure of put right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import yaml

from rpl_data.clicks.table import keypoints_in_csv
from rpl_data.doctor.findings import Diagnosis
from rpl_data.doctor.pairing import SURE
from rpl_data.files import read_text
from rpl_data.formats.recordings.ros.wanted import Topics
from rpl_data.recordings.mend import Mend, changed, in_recipe
from rpl_data.types import DataError, Recording
from rpl_data.untrusted.names import checked_keypoints, checked_name

KeypointsSaid = int | tuple[str, ...]
"""How many keypoints an object has, or their names in order."""


@dataclass(frozen=True)
class HowStored:
    """What a person says of a recording, which its files do not; as in `recipe.SceneSource`."""

    format: str | None = None
    camera: tuple[float, ...] | None = None
    topics: Topics | None = None

    @property
    def lines(self) -> list[str]:
        """The lines of a recipe that say it."""
        lines = [f"    format: {self.format}"]
        lines += [] if self.camera is None else [f"    camera: {list(self.camera)}"]
        if self.topics is not None:
            chosen = {key: value for key, value in asdict(self.topics).items() if value is not None}
            lines.append(f"    topics: {_flow(chosen)}")
        return lines


def keypoints_from(text: str, *, where: str) -> KeypointsSaid:
    """`8`, or `handle,spout,lid`, as a recipe holds them.

    Raises:
        DataError: neither a number nor names.
    """
    given = text.strip()
    if given.isascii() and given.isdigit():
        return int(given)
    names = tuple(part.strip() for part in given.strip("[]").split(","))
    if len(names) < 3:
        raise DataError(
            f"{where}: expected how many keypoints, or at least three names with commas, got {text!r}"
        )
    return tuple(checked_keypoints(names, where=where))


def mends(diagnosis: Diagnosis) -> Mend:
    """Everything that the doctor is sure mends a scene, together."""
    whole = Mend()
    for finding in diagnosis.findings:
        if finding.mend is not None and finding.sure >= SURE:
            whole = replace(whole, **changed(finding.mend))
    return whole


def recipe_text(
    path: str,
    told: HowStored,
    examined: Sequence[tuple[Recording, Diagnosis]],
    *,
    name: str,
    objects: Sequence[tuple[str, KeypointsSaid]],
    clicks: str | None,
) -> str:
    """A commented recipe for the scenes that were examined.

    Args:
        path: where the recording is, as the recipe shall say it.
        told: how it is stored.
        examined: each of its scenes, and what the doctor said of it.
        name: of the dataset.
        objects: name and keypoints of each object.
        clicks: the CSV file with their clicks, as the recipe shall say it; None where nothing is clicked yet.
    """
    lines = [
        f"name: {_flow(name)}  # of the dataset",
        "",
        "scenes:  # recordings of several places can be joined: add a `- path:` for each",
        *_sources(path, told, examined),
        "",
        "objects:  # what is labelled; several may stand in the same scenes",
    ]
    for item, keypoints in objects:
        lines += [
            f"  - name: {_flow(checked_name(item, 'object'))}",
            f"    keypoints: {_keypoints(keypoints)}  # how many, or names in order: [handle, spout, lid]",
        ]
        lines += [f"    clicks: {_flow(clicks)}"] if clicks else []
    return "\n".join([*lines, "", *_RECONSTRUCT, "label:", _rate(examined), *_REST]) + "\n"


USUAL_RATE_HZ, FEW_FRAMES = 3, 50
"""Where the usual rate labels fewer frames than these of all scenes together, every frame is labelled."""


def _rate(examined: Sequence[tuple[Recording, Diagnosis]]) -> str:
    """The line of the rate: the paper's 3 Hz, unless that leaves next to nothing of a short recording."""
    times_s = [[frame.timestamp_s for frame in recording.scene.frames] for recording, _ in examined]
    labelled = sum(1 + USUAL_RATE_HZ * (max(each) - min(each)) for each in times_s if each)
    if 0 < labelled < FEW_FRAMES:
        return f"  rate: all  # the recording is short: every frame; or frames per second, as {USUAL_RATE_HZ}"
    return f"  rate: {USUAL_RATE_HZ}  # frames per second that are labelled, or `all`"


_RECONSTRUCT = (
    "reconstruct:",
    "  method: auto  # the recording's poses where its images agree with them, else computed from the images",
)
_REST = (
    "split:",
    "  test_scenes: 1  # whole scenes that are never trained on; none where there are fewer than 3 scenes",
    "  val_fraction: 0.1",
    "export: [coco]  # `rpl export --help` names the other formats",
)


def _sources(path: str, told: HowStored, examined: Sequence[tuple[Recording, Diagnosis]]) -> list[str]:
    """The lines of `scenes:`, one source for all scenes that are mended alike."""
    alike: dict[Mend, list[str]] = {}
    for recording, diagnosis in examined:
        alike.setdefault(mends(diagnosis), []).append(recording.scene.name)
    lines = []
    for mend, names in alike.items():
        lines += [f"  - path: {_flow(path)}", *told.lines]
        lines += [f"    names: {_flow(names)}"] if len(alike) > 1 else []
        if mend != Mend():
            lines.append(f"    {in_recipe(mend)}  # as `rpl check` found")
    for recording, diagnosis in examined:
        for finding in diagnosis.findings:
            said_by_build = finding.kind in ("left out", "unreadable")
            halfway = finding.kind == "registration"  # its mend is right at one distance only
            if not said_by_build and (halfway or finding.mend is None or finding.sure < SURE):
                said = f"scene {recording.scene.name}: {finding.what}; {finding.todo}"
                lines.append(f"  # {' '.join(said.split())}")  # a name may hold a line break
    return lines


def _keypoints(keypoints: KeypointsSaid) -> str:
    return str(keypoints) if isinstance(keypoints, int) else _flow(list(keypoints))


def _flow(value: str | list[str] | dict[str, str]) -> str:
    """A string, or strings in a list or dictionary, as YAML on one line; quoted where YAML needs it."""
    text: str = yaml.safe_dump(value, default_flow_style=True, allow_unicode=True, width=10_000)
    return text.removesuffix("...\n").strip()


def path_from(recipe: Path, recording: Path) -> str:
    """The path of the recording as a recipe file says it: relative where it lies beside or below it."""
    place, whole = recipe.expanduser().absolute().parent.resolve(), recording.expanduser().resolve()
    return str(whole.relative_to(place)) if whole.is_relative_to(place) else str(whole)


def objects_clicked(file: Path) -> list[tuple[str, KeypointsSaid]]:
    """Names and keypoints of the objects that a CSV file has clicks for; [] where there is no such file.

    Raises:
        DataError: the file is no table of clicks.
    """
    if not file.is_file():
        return []
    found = keypoints_in_csv(read_text(file), source=str(file))
    return [(name, _numbered_or_named(said)) for name, said in sorted(found.items())]


def _numbered_or_named(said: list[str]) -> KeypointsSaid:
    """How many, where all are numbers; else their names, in the order in which they come."""
    if all(text.isascii() and text.isdigit() for text in said):
        return max(map(int, said)) + 1
    return tuple(said)
