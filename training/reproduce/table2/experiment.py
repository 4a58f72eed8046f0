"""Table II: poses of networks trained on our labels and on true labels, side by side."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

from rpl_data.torch.transforms import Augmentation

from ...runs.options import DetectorNetwork, Learning, Machine, Network


def table2(
    workspace: Path,
    objects: list[str],
    out: Path = Path("runs/table2"),
    network: Network = Network(),  # noqa: B008 (frozen)
    learning: Learning = Learning(),  # noqa: B008
    augment: Augmentation = Augmentation(),  # noqa: B008
    detector: DetectorNetwork = DetectorNetwork(),  # noqa: B008
    detector_learning: Learning = Learning(),  # noqa: B008
    machine: Machine = Machine(),  # noqa: B008
    validate_every: int = 1,
    seeds: int = 1,
) -> None:
    """Errors of poses by networks trained on our labels and on true ones (the paper's Table II).

    Four cells per object: crops given by the labels or found by the detector, in random frames of the
    training scenes (val, the paper's) or in scenes that training never saw (test). One hourglass per object
    and one detector per label source, with the same frames, steps and seeds for both sources. An interrupted
    experiment goes on when the same command is given again. table2.json and table2.html are written anew
    after each hourglass. Presets: --config table2_cpu, or table2_paper for the paper's network on a GPU.

    Args:
        workspace: a built workspace whose truth is known, of datasets/training_twin.yaml for example.
        objects: their names; the paper has three.
        out: folder for checkpoints, figures, table2.json and table2.html.
        network: the hourglass.
        learning: how long and how fast the hourglass is trained.
        augment: how far the hourglass's crops may stray; the detector's are not turned.
        detector: which detector, and how large.
        detector_learning: how long and how fast the detector is trained.
        machine: the hardware.
        validate_every: epochs from one validation to the next.
        seeds: how often each network is trained, with seeds 0, 1, ...; the intervals then cover them too.
    """
    from rpl_data.types import DataError

    from ...runs.folder import trained_epochs
    from ...train_detector import train_detector
    from ...train_keypoints import train_keypoints
    from ..label_sources import exports_of
    from .page import write_page
    from .pose_comparison import run_folder

    if seeds < 1:
        raise DataError(f"--seeds is {seeds}; at least 1 training per object and source is needed")
    exports = exports_of(workspace)
    check_objects(objects, exports["OURS"] / "train.json")
    upright = replace(augment, rotation_deg=0.0)
    for seed, (source, export) in product(range(seeds), exports.items()):  # first: every cell needs one
        run = run_folder(out, source, seed, "detector")
        if trained_epochs(run / "last.ckpt") < detector_learning.epochs:
            with _measured(run):
                train_detector(
                    export, run, detector, detector_learning, upright, machine,
                    validate_every=validate_every, seed=seed, resume=True,
                )  # fmt: skip
    for seed, name, (source, export) in product(range(seeds), objects, exports.items()):
        run = run_folder(out, source, seed, name)
        if trained_epochs(run / "last.ckpt") < learning.epochs:
            with _measured(run):
                train_keypoints(
                    export, name, run, network, learning, augment, machine,
                    validate_every=validate_every, seed=seed, resume=True,
                )  # fmt: skip
            write_page(out, workspace, objects, seeds)
    print(write_page(out, workspace, objects, seeds))


def check_objects(objects: Sequence[str], train_json: Path) -> None:
    """Refuse, with a DataError and before hours of training, objects that the labels do not have."""
    from rpl_data.formats.datasets.coco_parts import read_packed
    from rpl_data.types import DataError

    nothing = {"images": (), "annotations": (), "crowds": ()}
    known = [category["name"] for category in read_packed(train_json, nothing)["categories"]]
    unknown = [name for name in objects if name not in known]
    if unknown or not objects:
        asked = f"there is no object {', '.join(unknown)}" if unknown else "no object is named"
        raise DataError(f"{train_json}: {asked}; choose some of {', '.join(known)}")


class _measured:
    """Adds the CPU and wall-clock seconds of its block to <run>/seconds.json, over all resumptions."""

    def __init__(self, run: Path) -> None:
        self._path = run / "seconds.json"

    def __enter__(self) -> None:
        self._cpu_s, self._wall_s = time.process_time(), time.perf_counter()

    def __exit__(self, *_: object) -> None:
        from rpl_data.files import read_json, write_json

        before = read_json(self._path) if self._path.exists() else {"cpu_s": 0.0, "wall_s": 0.0}
        cpu_s, wall_s = time.process_time() - self._cpu_s, time.perf_counter() - self._wall_s
        write_json(self._path, {"cpu_s": before["cpu_s"] + cpu_s, "wall_s": before["wall_s"] + wall_s})
