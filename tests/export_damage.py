"""Exports with one fault each: every file missing, cut or empty, every field dropped or damaged in turn."""

from __future__ import annotations

import copy
import io
import json
import re
import tarfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from labelled_scenes import BOX, CAMERA, CAN, labelled_scene
from scipy.io import loadmat, savemat

from rpl_data.evaluate.truth import box_mesh
from rpl_data.export import (
    ExportScene,
    export_assets,
    export_bop,
    export_bundlesdf,
    export_coco,
    export_foundationpose,
    export_huggingface,
    export_linemod,
    export_nerfstudio,
    export_okt,
    export_webdataset,
    export_ycb_video,
    export_yolo,
)
from rpl_data.export.split import SplitRule
from rpl_data.meshes import save_mesh

NO_PLACE = -1e9
"""A number that no pixel, count, share, metre or millimetre of an export can be."""
SAME = r"(?<![a-z])(train|val|valid|validation|test|[ab])(?![a-z])|\d+"
"""Numbers, and names of splits and of the scenes a and b: files that differ in these are alike."""
WORDY = (".txt", ".xyz", ".yaml", ".yml", ".mtl")


def write_all(root: Path) -> Path:
    """Write two scenes of two frames, one of them for test, in every dialect; the box has a mesh.

    Returns:
        The folder with one export per dialect.
    """
    corners = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (0.0, 0.05)])
    save_mesh(root / "box.ply", box_mesh(corners))
    scenes = []
    for seed, name in enumerate("ab"):
        made = labelled_scene(root / "recording", name, seed=seed, frames=2)
        camera = CAMERA.__class__(150.0, 151.0, 79.5, 59.5, 160, 120)  # no lens, which not all can express
        scene = made.scene.__class__(name, camera, 0.001, made.scene.frames)
        scenes.append(ExportScene(scene, made.trajectory, made.labels))
    coco, rule = root / "export/coco", SplitRule(("b",), 0.0)
    export_coco(coco, scenes, [BOX, CAN], split=rule, meshes={"box": root / "box.ply"})
    write_dialects(root / "export", coco, {"a": 0.001, "b": 0.001})
    return root / "export"


def write_dialects(folder: Path, coco: Path, metres_per_unit: dict[str, float]) -> None:
    """Write what is made of a COCO folder, each dialect in a folder called like it."""
    for write in (export_yolo, export_okt, export_huggingface, export_webdataset, export_assets):
        write(folder / write.__name__.removeprefix("export_"), coco)
    with_units = (export_bop, export_foundationpose, export_bundlesdf, export_nerfstudio)
    for write in (*with_units, export_ycb_video, export_linemod):
        write(folder / write.__name__.removeprefix("export_"), coco, metres_per_unit)


@dataclass(frozen=True)
class Damage:
    """One fault.

    Attributes:
        file: the damaged file, relative to the export.
        field: names of what is damaged in it, from the outside in; empty for the whole file.
        how: what was done to it.
        content: the new bytes of the file; None = it is deleted.
    """

    file: str
    field: tuple[str, ...]
    how: str
    content: bytes | None

    @property
    def pattern(self) -> str:
        """File and field with # for each number."""
        return re.sub(SAME, "#", f"{self.file}: {'.'.join(self.field)}: {self.how}")


@contextmanager
def damaged(folder: Path, damage: Damage) -> Iterator[None]:
    """An export with a fault, for as long as the block lasts."""
    path = folder / damage.file
    sound = path.read_bytes()
    path.unlink()
    try:
        if damage.content is not None:
            path.write_bytes(damage.content)
        yield
    finally:
        path.write_bytes(sound)


def names(damage: Damage, fault: str) -> bool:
    """Whether a fault, as it is said, names the damaged file, and the field or what holds it."""
    fields = [name.partition(".")[0] for name in damage.field if not name.isdecimal()][-2:]
    said = [
        form for name in fields for form in (name, name.removesuffix("s"), name.removesuffix("ies") + "y")
    ]
    return str(Path(damage.file).with_suffix("")) in fault and (
        not said or any(name in fault for name in said)
    )


def one_of_each_kind(folder: Path) -> list[Path]:
    """One file of each kind: the largest, as the first may hold nothing."""
    kinds: dict[str, Path] = {}
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        kind = re.sub(SAME, "#", str(path.relative_to(folder)))
        if kind not in kinds or path.stat().st_size > kinds[kind].stat().st_size:
            kinds[kind] = path
    return list(kinds.values())


def damages(folder: Path) -> Iterator[Damage]:
    """Every damage to one file of each kind."""
    for path in one_of_each_kind(folder):
        name, content = str(path.relative_to(folder)), path.read_bytes()
        yield Damage(name, (), "missing", None)
        if content:
            yield Damage(name, (), "cut", content[: len(content) // 2])
            yield Damage(name, (), "empty", b"")
        if content and path.suffix == ".tar":
            yield Damage(name, (), "zeros", bytes(len(content)))
        yield from _inside(name, content)


def _inside(name: str, content: bytes) -> Iterator[Damage]:
    suffix = Path(name).suffix
    if suffix == ".json":
        for field, how, value in _json_damages(json.loads(content)):
            yield Damage(name, field, how, json.dumps(value).encode())
    elif suffix == ".jsonl":
        first, *rest = max(content.decode().splitlines(), key=len), *content.decode().splitlines()
        others = [line for line in rest if line != first]
        for field, how, value in _json_damages(json.loads(first)):
            yield Damage(name, field, how, "\n".join([json.dumps(value), *others, ""]).encode())
    elif suffix == ".mat":
        yield from _mat_damages(name, content)
    elif suffix in WORDY:
        for how, text in _word_damages(content.decode()):
            yield Damage(name, (), how, text.encode())
        if suffix in (".yaml", ".yml"):
            for field, how, value in _json_damages(yaml.safe_load(content)):
                yield Damage(name, field, how, yaml.safe_dump(value).encode())
    elif suffix in (".png", ".jpg"):
        image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
        yield Damage(name, (), "half as large", cv2.imencode(suffix, image[::2, ::2])[1].tobytes())
        if suffix == ".png":
            other = np.uint8 if image.dtype == np.uint16 else np.uint16
            yield Damage(name, (), "other bits", cv2.imencode(suffix, image.astype(other))[1].tobytes())
    elif suffix == ".tar":
        yield from _tar_damages(name, content)


def _json_damages(value: Any) -> Iterator[tuple[tuple[str, ...], str, Any]]:
    """Names, what was done, and the whole value with that done to it, for fields of the first of a list."""
    for field, path in _fields(value):
        whole, holder = copy.deepcopy(value), None
        holder = whole
        for step in path[:-1]:
            holder = holder[step]
        old = holder[path[-1]]
        replacements: dict[str, Any] = {"null": None, "text": 7 if isinstance(old, str) else "x"}
        if isinstance(old, int | float) and not isinstance(old, bool):
            replacements["no number that can be"] = NO_PLACE
        if isinstance(old, list) and old:
            replacements["shorter"] = old[:-1]
        for how, new in replacements.items():
            if new != old:
                holder[path[-1]] = new
                yield field, how, copy.deepcopy(whole)
        if isinstance(holder, dict):
            del holder[path[-1]]
            yield field, "dropped", whole


def _fields(
    value: Any, path: tuple[str | int, ...] = ()
) -> Iterator[tuple[tuple[str, ...], tuple[str | int, ...]]]:
    if path:
        yield tuple(step for step in path if isinstance(step, str)), path
    if isinstance(value, dict):
        numbered = [key for key in value if str(key).isdecimal()]
        longest = max(numbered, key=lambda key: len(str(value[key])), default=None)
        for key, item in value.items():
            if key not in numbered or key == longest:
                yield from _fields(item, (*path, key))
    elif isinstance(value, list) and value:
        row = next((row for row, item in enumerate(value) if item is not None), 0)
        yield from _fields(value[row], (*path, row))


def _word_damages(text: str) -> Iterator[tuple[str, str]]:
    lines = text.splitlines()
    if not lines:
        return
    row = next((row for row, line in enumerate(lines) if line.strip()), 0)
    yield f"line {row + 1} dropped", "\n".join([*lines[:row], *lines[row + 1 :], ""])
    words = re.split(r"(\s+)", lines[row])
    for at in range(0, len(words), 2):
        for word in ("x", f"{NO_PLACE}", ""):
            if words[at] and not words[at].endswith(":"):
                line = "".join([*words[:at], word, *words[at + 1 :]])
                yield (
                    f"word {at // 2 + 1} is {word!r}",
                    "\n".join([*lines[:row], line, *lines[row + 1 :], ""]),
                )


def _mat_damages(name: str, content: bytes) -> Iterator[Damage]:
    """Each array dropped, one shorter, with a number that cannot be, or with one that is none."""
    arrays = {key: array for key, array in loadmat(io.BytesIO(content)).items() if not key.startswith("__")}
    for key, array in arrays.items():
        others = {other: arrays[other] for other in arrays if other != key}
        numbers = array.astype(np.float64)
        replacements = {"shorter": numbers[..., :-1], "text": np.array("x")}
        for how, value in (("no number that can be", NO_PLACE), ("not finite", np.nan)):
            replacements[how] = np.where(np.arange(numbers.size).reshape(numbers.shape) == 0, value, numbers)
        for how, new in replacements.items():
            yield Damage(name, (key,), how, _mat({**others, key: new}))
        yield Damage(name, (key,), "dropped", _mat(others))


def _mat(arrays: dict[str, Any]) -> bytes:
    file = io.BytesIO()
    savemat(file, arrays)
    return file.getvalue()


def _tar_damages(name: str, content: bytes) -> Iterator[Damage]:
    with tarfile.open(fileobj=io.BytesIO(content)) as tar:
        members = [(member.name, tar.extractfile(member).read()) for member in tar]
    sizes = {name: len(data) for name, data in members if name.endswith(".json")}
    key = max(sizes, key=sizes.__getitem__).removesuffix(".json")
    for row, (member, data) in enumerate(members):
        if member.partition(".")[0] != key:
            continue
        yield Damage(name, (member,), "missing", _packed([*members[:row], *members[row + 1 :]]))
        for damage in _inside(member, data) if member.endswith(".json") else _cut(member, data):
            others = [*members[:row], (member, damage.content or b""), *members[row + 1 :]]
            yield Damage(name, (member, *damage.field), damage.how, _packed(others))


def _cut(name: str, data: bytes) -> Iterator[Damage]:
    yield Damage(name, (), "cut to a tenth", data[: len(data) // 10])
    yield from _inside(name, data)


def _packed(members: list[tuple[str, bytes]]) -> bytes:
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode="w", format=tarfile.USTAR_FORMAT) as tar:
        for name, data in members:
            entry = tarfile.TarInfo(name)
            entry.size = len(data)
            tar.addfile(entry, io.BytesIO(data))
    return file.getvalue()
