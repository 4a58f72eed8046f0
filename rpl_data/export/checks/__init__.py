"""Checks of exports: what is wrong in which file, record and field. `rpl check EXPORT` runs them.

A dialect added to `export` gets a module here with a function that says whether a folder looks like it, and
one that adds faults to `Findings`, and an entry in `CHECKS`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from rpl_data.export.checks.assets import check_assets, looks_like_assets
from rpl_data.export.checks.bop import (
    check_bop,
    check_bop_onboarding,
    looks_like_bop,
    looks_like_bop_onboarding,
)
from rpl_data.export.checks.checksums import check_checksums
from rpl_data.export.checks.coco import (
    check_coco,
    check_coco_per_object,
    holds_exports,
    looks_like_coco,
    looks_like_coco_per_object,
)
from rpl_data.export.checks.findings import Fault, Findings
from rpl_data.export.checks.huggingface import check_huggingface, looks_like_huggingface
from rpl_data.export.checks.linemod import check_linemod, looks_like_linemod
from rpl_data.export.checks.nerfstudio import check_nerfstudio, looks_like_nerfstudio
from rpl_data.export.checks.object_views import (
    check_bundlesdf,
    check_foundationpose,
    looks_like_bundlesdf,
    looks_like_foundationpose,
)
from rpl_data.export.checks.okt import check_okt, looks_like_okt
from rpl_data.export.checks.webdataset import check_webdataset, looks_like_webdataset
from rpl_data.export.checks.ycb_video import check_ycb_video, looks_like_ycb_video
from rpl_data.export.checks.yolo import check_yolo, looks_like_yolo
from rpl_data.types import DataError

__all__ = ["CHECKS", "Fault", "check_export", "dialect_of", "holds_exports"]


@dataclass(frozen=True)
class Check:
    """How to recognise and check a dialect.

    Attributes:
        looks_like: whether a folder is one, by what is in it.
        check: adds the faults of a folder.
    """

    looks_like: Callable[[Path], bool]
    check: Callable[[Findings], None]


CHECKS = {
    "coco": Check(looks_like_coco, check_coco),
    "yolo": Check(looks_like_yolo, check_yolo),
    "bop": Check(looks_like_bop, check_bop),
    "bop_onboarding": Check(looks_like_bop_onboarding, check_bop_onboarding),
    "ycb_video": Check(looks_like_ycb_video, check_ycb_video),
    "linemod": Check(looks_like_linemod, check_linemod),
    "okt": Check(looks_like_okt, check_okt),
    "foundationpose": Check(looks_like_foundationpose, check_foundationpose),
    "bundlesdf": Check(looks_like_bundlesdf, check_bundlesdf),
    "nerfstudio": Check(looks_like_nerfstudio, check_nerfstudio),
    "huggingface": Check(looks_like_huggingface, check_huggingface),
    "webdataset": Check(looks_like_webdataset, check_webdataset),
    "assets": Check(looks_like_assets, check_assets),
    "coco_per_object": Check(looks_like_coco_per_object, check_coco_per_object),
}
"""By the name of the dialect in a recipe."""


def dialect_of(folder: Path) -> str | None:
    """The dialect of an exported folder, by its name in `export/` or by what is in it, or None."""
    if not folder.is_dir():
        return None
    name = folder.name.removesuffix("_truth")
    if folder.parent.name == "export" and name in CHECKS:
        return name
    return next((name for name, check in CHECKS.items() if check.looks_like(folder)), None)


def check_export(folder: Path, dialect: str | None = None) -> list[Fault]:
    """Find everything that is wrong with an exported folder; nothing is changed.

    Args:
        folder: folder of one dialect.
        dialect: a key of `CHECKS`; guessed when left out.

    Raises:
        DataError: there is no such folder, or it looks like no dialect.
    """
    if not folder.is_dir():
        raise DataError(f"there is no folder {folder}; check the path")
    known = dialect or dialect_of(folder)
    if known not in CHECKS:
        named = f"unknown dialect {known!r}" if known else f"{folder} looks like no export"
        raise DataError(f"{named}; expected one of {', '.join(CHECKS)}")
    findings = Findings(folder)
    CHECKS[known].check(findings)
    check_checksums(findings)
    return findings.faults
