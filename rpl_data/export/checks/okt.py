"""Check of ObjectKeypointTrainer's datasets; the layout is described in `export.okt`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rpl_data.export.checks.findings import Findings, stems
from rpl_data.export.checks.rules import FARTHEST_PX, camera_matrix
from rpl_data.export.okt import LISTS

FILES = {
    "center": "center_{}.txt", "scale": "scales_{}.txt", "label": "label_{}.txt",
    "bboxes": "frame_{}.txt", "masks": "mask_{}.png",
}  # fmt: skip
"""Names of a frame's files by their folder, around its number."""


def looks_like_okt(folder: Path) -> bool:
    """Whether a folder has objects with scales and centres of their frames."""
    return any((path / "scale").is_dir() and (path / "center").is_dir() for path in folder.glob("*"))


def check_okt(findings: Findings) -> None:
    """Check the dataset of each object."""
    objects = sorted(path.name for path in findings.folder.iterdir() if path.is_dir())
    if not objects:
        findings.add("", "", "", "there is no folder of an object")
    for name in objects:
        keypoints = [line for line in findings.lines(f"{name}/keypoints.txt") if line.strip()]
        _check_camera(findings, f"{name}/camera_matrix.npy")
        numbers = {stem.removeprefix("frame_") for stem in stems(findings.folder / name / "frames")}
        for kind, pattern in FILES.items():
            before = len(pattern.split("{}")[0])
            numbers |= {stem[before:] for stem in stems(findings.folder / name / kind)}
        for number in sorted(numbers):
            _check_frame(findings, name, number, len(keypoints))
        _check_lists(findings, name, numbers)


def _check_camera(findings: Findings, file: str) -> None:
    try:
        matrix = np.load(findings.folder / file, allow_pickle=False)
        camera_matrix(np.asarray(matrix, dtype=np.float64).reshape(9).tolist())
    except (OSError, EOFError, ValueError, TypeError) as error:
        findings.add(file, "", "numbers", str(error).replace(f"{findings.folder}/", "")[:200])


def _check_frame(findings: Findings, name: str, number: str, keypoints: int) -> None:
    frame = f"{name}/frames/frame_{number}.jpg"
    image = findings.image(frame)
    size = None if image is None else (image.shape[1], image.shape[0])
    paths = {kind: f"{name}/{kind}/{pattern.format(number)}" for kind, pattern in FILES.items()}
    findings.image(paths["masks"], size=size, like=frame, kind="mask")
    shapes = {"center": (2, 1), "scale": (1, 1), "label": (None, 2), "bboxes": (1, 5)}
    tables = {kind: findings.numbers(paths[kind], rows, columns) for kind, (rows, columns) in shapes.items()}
    for kind in ("center", "label"):
        table = tables[kind]
        if table is not None and np.abs(table).max() > FARTHEST_PX:
            findings.add(paths[kind], "", "numbers", f"expected pixels, found {table.ravel().tolist()!s:.80}")
    if (label := tables["label"]) is not None and len(label) != keypoints:
        what = f"expected the {keypoints} keypoints of {name}/keypoints.txt, found {len(label)}"
        findings.add(paths["label"], "", "numbers", what)
    scale, box = tables["scale"], tables["bboxes"]
    if scale is not None and not 0 < scale.item() <= FARTHEST_PX:
        findings.add(paths["scale"], "", "numbers", f"expected a number above 0, found {scale.item()}")
    if box is not None and not (
        box[0, 0] == 0 and (box[0, 1:] >= 0).all() and (box[0, 1:] <= 1).all() and (box[0, 3:] > 0).all()
    ):
        what = "expected class 0 and a box in shares of the image"
        findings.add(paths["bboxes"], "", "numbers", f"{what}, found {box.ravel().tolist()}")


def _check_lists(findings: Findings, name: str, numbers: set[str]) -> None:
    """Each frame is in one list, by a path that leads to it."""
    listed: list[str] = []
    files = ", ".join(f"{name}/{file}" for file in LISTS.values())
    for file in LISTS.values():
        if not (findings.folder / name / file).exists():
            continue
        for row, line in enumerate(findings.lines(f"{name}/{file}"), start=1):
            path = Path(line.strip())
            listed.append(path.stem.removeprefix("frame_"))
            if not path.is_file():
                what = "the lists have absolute paths: export again where the folder was moved"
                findings.add(f"{name}/{file}", f"line {row}", "path", f"there is no {line!s:.120}; {what}")
    for number in sorted(numbers.symmetric_difference(listed)):
        findings.add(files, "", "path", f"frame {number} is in no list or not there")
    if len(set(listed)) < len(listed):
        findings.add(files, "", "path", "a frame is listed twice")
