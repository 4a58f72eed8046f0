"""Score trained networks at estimating poses: `rpl evaluate poses --help`."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rpl_data.pose.estimate import Method
from rpl_data.types import DataError
from rpl_data.wording import counted

from .runs.options import Crops, UseDepth
from .runs.program import reasons

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
    depth: UseDepth = "auto",
    metres_per_unit: float | None = None,
    symmetric: bool = False,
    bop: bool = False,
    out: Path | None = None,
    threads: int | None = None,
) -> None:
    """Median position and orientation error, ADD, recalls and PCK against true poses.

    The strict protocol is the default: scenes that training never saw, crops of the detector, and failures
    that count as infinite errors. Instances that show less than a tenth of themselves are not judged. The
    paper's is `--split val --crops given`. For example: rpl evaluate poses
    my-workspace/export/coco_truth --keypoints '[drill/last.ckpt]' --detector detector/last.ckpt. With --out,
    writes <split>_poses.json: the figures, ADD-S among them, and every instance.

    Args:
        coco: folder with true labels: export/coco_truth (or export/coco to see how well labels are learned).
        keypoints: checkpoint of `rpl train keypoints`, or a list with one per object.
        detector: checkpoint of `rpl train detector`; not needed when crops are given.
        split: train, val or test.
        crops: `given` takes the labels' boxes, `detected` the detector's.
        methods: of PnP. Only ransac and consensus use depth.
        depth: whether poses use the depth at the keypoints too; `auto` where an image has depth in a known
            unit. The paper's do not.
        metres_per_unit: of the depth images (0.001 for millimetres), for an export that does not say it.
        symmetric: compare each pose with the nearest of those that look the same, by the symmetries in the
            export, and PCK with its keypoints: for networks that were trained with --canonical true.
        bop: also score as the BOP benchmark does (VSD, MSSD, MSPD and their average recall; VSD needs
            depth images), with the areas under the curves of ADD and ADD-S up to 0.1 m and COCO's keypoint
            precision, and write the poses as its CSV files, <method>_rpl-<split>.csv, into --out.
        out: folder for the figures; nothing is written when left out.
        threads: processor threads of torch; None leaves the number to torch.
    """
    from rpl_data.torch.splits import split_file

    from .pose.evaluation import evaluate, true_objects
    from .pose.pipeline import load_pipeline
    from .runs.program import say_left_out, use_threads
    from .runs.trained_scenes import say_trained

    refuse_contradictions(split, methods, bop=bop, out=out)
    if detector is None and crops == "detected":
        raise DataError(
            "nothing says where the objects are in the images; give --detector, a checkpoint of `rpl train "
            "detector`, or take the labels' boxes by --crops given"
        )
    methods = list(dict.fromkeys(methods))
    use_threads(threads)
    networks = [keypoints] if isinstance(keypoints, Path) else keypoints
    detectors = [detector] if detector is not None and crops == "detected" else []
    pipeline = load_pipeline(networks, *detectors)
    coco_json = split_file(coco, split)
    truth = true_objects(coco_json, pipeline.networks)
    if split == "test":
        say_trained([*networks, *detectors], coco_json)
    if depth == "auto":
        say_depth(coco_json, metres_per_unit, methods)
    unreadable: Counter[str] = Counter()
    judged = list(
        evaluate(
            pipeline,
            coco_json,
            crops=crops,
            methods=methods,
            truth=truth,
            use_depth=depth,
            metres_per_unit=metres_per_unit,
            symmetric=symmetric,
            unreadable=unreadable,
        )
    )
    refuse_nothing_judged(judged, pipeline.networks, coco_json, unreadable)
    surfaces = {name: truth[name].surface for name in pipeline.networks}
    figures = figures_of(judged, surfaces, methods)
    if bop and out is not None:
        add_benchmark(figures, judged, coco_json, out, metres_per_unit)
    say_figures(figures, judged)
    say_left_out(unreadable)
    if out is not None:
        write_figures(out / f"{split}_poses.json", figures, judged)


def refuse_contradictions(split: str, methods: Sequence[Method], *, bop: bool, out: Path | None) -> None:
    """Raise a DataError where options do not go together, before anything is read."""
    if not methods:
        raise DataError("--methods names none; give some of epnp, sqpnp, ransac and consensus")
    if out is not None and out.suffix == ".json":
        raise DataError(f"--out is a folder, {split}_poses.json is written into it; got the file {out}")
    if bop and out is None:
        raise DataError("--bop writes the poses as CSV files: give their folder as --out")


def refuse_nothing_judged(
    judged: Sequence[Judged], names: Iterable[str], coco_json: Path, unreadable: Mapping[str, int]
) -> None:
    """Raise a DataError where there is nothing to score: a figure of nothing would be none."""
    if not judged:
        first = next(iter(unreadable), None)
        why = "shows a tenth of it or more" if first is None else f"can be read ({first})"
        raise DataError(
            f"{coco_json}: no image with {', '.join(names)} {why}, so there is nothing to score; choose "
            "another --split, or export again"
        )


def say_depth(coco_json: Path, metres_per_unit: float | None, methods: Sequence[Method]) -> None:
    """Say how many images have depth that the poses will use, where a method uses any."""
    from rpl_data.formats.datasets.coco_parts import read_packed

    from .pose.evaluation import has_depth
    from .pose.pipeline import WEIGHING

    using = [method for method in methods if method in WEIGHING]
    if not using:
        return
    images = read_packed(coco_json, {"annotations": (), "crowds": ()})["images"]
    known = sum(has_depth(image, metres_per_unit) for image in images)
    use = "uses" if len(using) == 1 else "use"
    print(f"{' and '.join(using)} {use} the depth of {known} of {counted(len(images), 'image')}")


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


def add_benchmark(
    figures: Mapping[str, dict[str, Any]],
    judged: Sequence[Judged],
    coco_json: Path,
    out: Path,
    metres_per_unit: float | None,
) -> None:
    """Add the scores of the benchmark to the figures, as `bop`, and write its CSV files into `out`."""
    from rpl_data.formats.datasets.bop_results import PoseResult, write_bop_results

    from .pose.benchmark import Benchmark

    benchmark = Benchmark(coco_json, metres_per_unit=metres_per_unit)
    results: dict[str, list[PoseResult]] = {}
    for name, found in figures.items():
        object, _, method = name.rpartition(" ")
        mine = [each for each in judged if (each.object, each.method) == (object, method)]
        found["bop"] = asdict(benchmark.score(mine))
        results.setdefault(method, []).extend(benchmark.results(mine))
    for method, poses in results.items():
        write_bop_results(out / f"{method}_rpl-{coco_json.stem}.csv", poses)


def say_figures(figures: Mapping[str, Mapping[str, Any]], judged: Sequence[Judged]) -> None:
    """A line per object and method, one of why poses are missing, and one of the benchmark's scores."""
    for name, found in figures.items():
        print(f"{name:24s} {line_of(found)}")
        none = [e.found for e in judged if f"{e.object} {e.method}" == name and e.found != "ok"]
        if none:
            print(f"{'':24s} no pose: {reasons(none)}")
        if "bop" in found:
            print(f"{'':24s} {benchmark_line(found['bop'])}")


def benchmark_line(found: Mapping[str, Any]) -> str:
    """The figures of `BenchmarkScore` in a line."""

    def shown(name: str) -> str:
        return "none" if found[name] is None else f"{found[name]:.3f}"

    recalls = f"VSD {shown('recall_vsd')}, MSSD {shown('recall_mssd')}, MSPD {shown('recall_mspd')}"
    areas = f"AUC of ADD {shown('auc_add')}, of ADD-S {shown('auc_adds')}"
    without = "" if found["recall_vsd"] is not None else " (VSD needs depth images in a known unit)"
    return f"AR {shown('average_recall')} ({recalls}){without}, {areas}, OKS AP {shown('oks_ap')}"


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
    if not found["instances"]:
        return "   0 instances: nothing to score"
    pose = f"{found['position_mm']:.1f} mm, {found['orientation_deg']:.2f} deg"
    add = f"ADD {found['add_mm']:.1f} mm (recall {found['recall_add']:.3f})"
    near = f"5 cm 5 deg {found['recall_5cm_5deg']:.3f}"
    instances = f"{found['instances']:4d} instances, {found['failures']} without a pose"
    return f"{instances}: {pose}, {add}, {near}, PCK {found['pck']:.3f}"


if __name__ == "__main__":
    from .runs.program import main

    sys.exit(main(evaluate_pose))
