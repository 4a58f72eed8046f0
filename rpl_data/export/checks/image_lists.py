"""Check of lists of images, one per split, as LINEMOD and YCB-Video have them."""

from __future__ import annotations

from collections.abc import Set

from rpl_data.export.checks.findings import Findings
from rpl_data.export.dialect import SPLITS


def check_lists(findings: Findings, place: str, images: Set[str], why: str) -> None:
    """Check that train.txt, val.txt and test.txt have each image once, and no others.

    Args:
        findings: the faults so far.
        place: folder of the lists, relative to the export.
        images: names that the lists must have.
        why: which those are, for the message.
    """
    files = {split: f"{place}/{split}.txt" for split in SPLITS}
    lists = {file: findings.lines(file) for file in files.values() if (findings.folder / file).exists()}
    listed: set[str] = set()
    for file, lines in lists.items():
        for row, name in enumerate(lines, start=1):
            if name in listed:
                findings.add(file, f"line {row}", "image", f"{name} is listed twice")
            elif name not in images:
                findings.add(file, f"line {row}", "image", f"expected {why}, found {name!r:.60}")
            listed.add(name)
    for name in sorted(images - listed):
        findings.add(", ".join(files.values()), "", "image", f"{name} is in none of them")
