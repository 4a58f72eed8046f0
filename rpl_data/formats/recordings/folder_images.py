"""Images of a folder for colour and one for depth, paired by their names, which may be times."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

from rpl_data.formats.recordings.depth_files import SUFFIXES
from rpl_data.formats.recordings.frame_files import Pair, grouped
from rpl_data.formats.recordings.times import FRAME_RATE_HZ, clock_of
from rpl_data.types import DataError

COLOR_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".webp", ".tif", ".tiff")
_TIME = re.compile(r"\d{1,10}\.\d{1,9}|[1-9]\d{9,18}")


@dataclass(frozen=True)
class Paired:
    """The images of a scene.

    Attributes:
        pairs: in their order.
        clock: says where their times are from.
        alone: lines about images without a partner.
    """

    pairs: list[Pair]
    clock: str
    alone: tuple[str, ...]


def paired_images(color_folder: Path, depth_folder: Path) -> Paired:
    """Pair images of the same name, or of the same number.

    `Pair.index` is the number in the name. Where names are times, or numbers of several runs share the
    folder, it is the place in their order.

    Raises:
        DataError: no colour image has a partner, or two of a folder have the same numbers.
    """
    colors, depths = images_by_key(color_folder, COLOR_SUFFIXES), images_by_key(depth_folder, SUFFIXES)
    both = sorted(colors.keys() & depths.keys())
    if not both:
        raise DataError(
            f"no image of {color_folder} ({len(colors)}) has the name or the number of one of {depth_folder} "
            f"({len(depths)}); name the two images of a frame alike"
        )
    lines: list[str] = []
    for kind, alone in (("colour", colors.keys() - both), ("depth", depths.keys() - both)):
        other = "depth" if kind == "colour" else "colour"
        numbers = [key[-1] if key else 0 for key in sorted(alone)]
        lines += grouped(numbers, f"with a {kind} image, but no {other} image of that name")
    stamps = _times_in_names([colors[key].stem for key in both])
    if stamps is not None:
        clock = clock_of([float(stamp) for stamp in stamps], color_folder)
        rows = enumerate(sorted(zip(stamps, both, strict=True)))
        pairs = [
            Pair(row, float(stamp * Fraction(clock.unit_s)), colors[key], depths[key])
            for row, (stamp, key) in rows
        ]
        note = clock.note or f"the names in {color_folder.name}/ are times in seconds"
        return Paired(pairs, note, tuple(lines))
    numbers = [key[-1] for key in both if key]
    own = len(numbers) == len(both) and all(a < b for a, b in pairwise(numbers))
    pairs = [
        Pair(key[-1] if own else row, (key[-1] if own else row) / FRAME_RATE_HZ, colors[key], depths[key])
        for row, key in enumerate(both)
    ]
    return Paired(pairs, f"no times: {FRAME_RATE_HZ:g} frames per second assumed", tuple(lines))


def _times_in_names(stems: Sequence[str]) -> list[Fraction] | None:
    """The times that names are, in any unit: decimal numbers, or as long as times since 1970 are."""
    return [Fraction(stem) for stem in stems] if all(map(_TIME.fullmatch, stems)) else None


def images_by_key(folder: Path, suffixes: Sequence[str]) -> dict[tuple[int, ...], Path]:
    """Images of a folder by the numbers in their names: 000012.png, frame-12.color.jpg and 12.npy match."""
    found: dict[tuple[int, ...], Path] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() in suffixes and not path.name.startswith("."):
            key = numbers_of(path)
            if key in found and found[key].stem == path.stem:
                continue  # the same image in a second format
            if key in found:
                raise DataError(f"{found[key]} and {path} have the same numbers; take one of them out")
            found[key] = path
    return found


def numbers_of(path: Path) -> tuple[int, ...]:
    """The numbers in a file's name, without its suffix."""
    return tuple(int(digits) for digits in re.findall(r"\d+", path.stem))
