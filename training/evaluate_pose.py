"""Score trained networks at estimating poses: `rpl evaluate poses --help`."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rpl_data.pose.estimate import Method
from rpl_data.types import DataError

from .runs.options import Crops

TYPE_CHECKING = False  # not typing's: the parser of the options would import what follows, torch and all
if TYPE_CHECKING:
    from .pose.scores import Judged


def evaluate_pose(
    coco: Path,
    keypoints: list[Path] | Path = [],  # noqa: B006 (never changed)
    detector: Path | None = None,
    split: str = "test",
    crops: Crops = "detected",
    methods: list[Method] = ["epnp", "consensus"],  # noqa: B006
    metres_per_unit: float | None = None,
    out: Path | None = None,
    threads: int | None = None,
) -> None:
    """Median position and orientation error, ADD, ADD-S, recall and PCK against true poses.

    The strict protocol is the default: scenes that training never saw, crops of the detector, and failures
    that count as infinite errors. The paper's is `--split val --crops given`. For example: rpl evaluate poses
    my-workspace/export/coco_truth --keypoints '[drill/last.ckpt]' --detector detector/last.ckpt. With --out,
    writes <split>_poses.json: the figures and every instance.

    Args:
        coco: folder with true labels: export/coco_truth (or export/coco to see how well labels are learned).
        keypoints: checkpoint of `rpl train keypoints`, or a list with one per object.
        detector: checkpoint of `rpl train detector`; not needed when crops are given.
        split: train, val or test.
        crops: `given` takes the labels' boxes, `detected` the detector's.
        methods: of PnP. Only ransac and consensus use depth.
        metres_per_unit: of the export's depth images (0.001 for millimetres). When given, poses use the depth
            at the keypoints too.
        out: folder for the figures; nothing is written when left out.
        threads: processor threads of torch; None leaves the number to torch.
    """
    from rpl_data.torch.splits import split_file

    from .pose.evaluation import evaluate, true_objects
    from .pose.pipeline import load_pipeline
    from .runs.program import say_left_out, use_threads

    if out is not None and out.suffix == ".json":
        raise DataError(f"--out is a folder, {split}_poses.json is written into it; got the file {out}")
    use_threads(threads)
    pipeline = load_pipeline([keypoints] if isinstance(keypoints, Path) else keypoints, detector)
    coco_json = split_file(coco, split)
    truth = true_objects(coco_json)
    unreadable: Counter[str] = Counter()
    judged = list(
        evaluate(
            pipeline,
            coco_json,
            crops=crops,
            methods=methods,
            truth=truth,
            metres_per_unit=metres_per_unit,
            unreadable=unreadable,
        )
    )
    surfaces = {name: truth[name].surface for name in pipeline.networks}
    figures = figures_of(judged, surfaces, methods)
    for name, found in figures.items():
        print(f"{name:24s} {line_of(found)}")
    say_left_out(unreadable)
    if out is not None:
        write_figures(out / f"{split}_poses.json", figures, judged)


def figures_of(
    judged: Sequence[Judged], surfaces: Mapping[str, Any], methods: Sequence[Method]
) -> dict[str, dict[str, Any]]:
    """The fields of `PoseScore` for each "object method"."""
    from .pose.scores import score

    return {
        f"{name} {method}": asdict(
            score([each for each in judged if (each.object, each.method) == (name, method)], surface)
        )
        for name, surface in surfaces.items()
        for method in methods
    }


def write_figures(path: Path, figures: Mapping[str, Any], judged: Sequence[Judged]) -> None:
    """The figures and one row per instance, as JSON; infinite errors as null."""
    from rpl_data.files import write_json

    from .pose.scores import finite

    rows = [
        {"object": e.object, "image": e.image, "method": e.method, "found": e.found, **asdict(e.errors)}
        for e in judged
    ]
    write_json(path, finite({"figures": figures, "instances": rows}))


def line_of(found: Mapping[str, Any]) -> str:
    """The figures of `PoseScore` in a line."""
    pose = f"{found['position_mm']:.1f} mm, {found['orientation_deg']:.2f} deg"
    add = f"ADD {found['add_mm']:.1f} mm (recall {found['recall_add']:.3f})"
    instances = f"{found['instances']:4d} instances, {found['failures']} without a pose"
    return f"{instances}: {pose}, {add}, PCK {found['pck']:.3f}"


if __name__ == "__main__":
    from .runs.program import main

    sys.exit(main(evaluate_pose))
