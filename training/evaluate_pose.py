"""How good trained networks are at poses: `python -m training.evaluate_pose --help`."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path

from rpl_data.pose.estimate import Method
from training.runs.options import Crops


def evaluate_pose(
    coco: Path,
    keypoints: list[Path] = [],  # noqa: B006 (never changed)
    detector: Path | None = None,
    split: str = "test",
    crops: Crops = "detected",
    methods: list[Method] = ["epnp", "consensus"],  # noqa: B006
    metres_per_unit: float | None = None,
    out: Path | None = None,
) -> None:
    """Median position and orientation error, ADD, ADD-S, recall and PCK against true poses.

    The strict protocol is the default: scenes training never saw, crops of the detector, failures counted as
    infinite. The paper's is `--split val --crops given`. For example: export/coco_truth --keypoints
    '[drill/last.ckpt]' --detector detector/last.ckpt.

    Args:
        coco: folder with true labels: export/coco_truth (or export/coco to see how well labels are learned).
        keypoints: checkpoints of train_keypoints, one an object.
        detector: checkpoint of train_detector; not needed when crops are given.
        split: train, val or test.
        crops: `given` takes the labels' boxes, `detected` the detector's.
        methods: of PnP; depth is for those that refine, ransac and consensus.
        metres_per_unit: of the export's depth images (0.001 = millimetres); poses use depth at the keypoints
            too, when given.
        out: a JSON file for the figures and every instance.
    """
    from training.pose.evaluation import evaluate, true_objects
    from training.pose.pipeline import load_pipeline
    from training.pose.scores import score

    pipeline = load_pipeline(keypoints, detector)
    coco_json = coco / f"{split}.json"
    truth = true_objects(coco_json)
    judged = list(
        evaluate(
            pipeline,
            coco_json,
            crops=crops,
            methods=methods,
            truth=truth,
            metres_per_unit=metres_per_unit,
        )
    )
    figures = {}
    for name in pipeline.networks:
        for method in methods:
            rows = [each for each in judged if (each.object, each.method) == (name, method)]
            found = figures[f"{name} {method}"] = asdict(score(rows, truth[name].surface))
            print(f"{name:14s} {method:9s} {line_of(found)}")
    if out is not None:
        from rpl_data.files import write_json
        from training.pose.scores import finite

        rows = [
            {"object": e.object, "image": e.image, "method": e.method, "found": e.found, **asdict(e.errors)}
            for e in judged
        ]
        write_json(out, finite({"figures": figures, "instances": rows}))


def line_of(found: dict[str, float]) -> str:
    """The figures of `PoseScore` in a line."""
    pose = f"{found['position_mm']:.1f} mm, {found['orientation_deg']:.2f} deg"
    add = f"ADD {found['add_mm']:.1f} mm (recall {found['recall_add']:.3f})"
    instances = f"{found['instances']:4d} instances, {found['failures']} without a pose"
    return f"{instances}: {pose}, {add}, PCK {found['pck']:.3f}"


if __name__ == "__main__":
    from training.runs.program import main

    sys.exit(main(evaluate_pose))
