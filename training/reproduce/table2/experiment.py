"""Table II: poses of networks trained on our labels and on true labels, side by side."""

from __future__ import annotations

import time
from dataclasses import replace
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
    seed: int = 0,
) -> None:
    """Errors of poses by networks trained on our labels and on true ones (the paper's Table II).

    One hourglass per object and one detector per label source, with the same frames, steps and seed for both
    sources. An interrupted experiment goes on when the same command is given again. table2.json and
    table2.html are written anew after each hourglass. Preset: --config table2_cpu.

    Args:
        workspace: a built workspace whose truth is known.
        objects: their names; the paper has three.
        out: folder for checkpoints, figures, table2.json and table2.html.
        network: the hourglass.
        learning: how long and how fast the hourglass is trained.
        augment: how far the hourglass's crops may stray; the detector's are not turned.
        detector: which detector, and how large.
        detector_learning: how long and how fast the detector is trained.
        machine: the hardware.
        validate_every: epochs from one validation to the next.
        seed: of everything that is drawn at random.
    """
    from ...runs.folder import trained_epochs
    from ...train_detector import train_detector
    from ...train_keypoints import train_keypoints
    from ..label_sources import exports_of
    from .page import write_page

    exports = exports_of(workspace)
    upright = replace(augment, rotation_deg=0.0)
    for source, export in exports.items():  # first, so that every hourglass is judged by both protocols
        run = out / source / "detector"
        if trained_epochs(run / "last.ckpt") < detector_learning.epochs:
            with _measured(run):
                train_detector(
                    export, run, detector, detector_learning, upright, machine,
                    validate_every=validate_every, seed=seed, resume=True,
                )  # fmt: skip
    for name in objects:
        for source, export in exports.items():
            run = out / source / name
            if trained_epochs(run / "last.ckpt") < learning.epochs:
                with _measured(run):
                    train_keypoints(
                        export, name, run, network, learning, augment, machine,
                        validate_every=validate_every, seed=seed, resume=True,
                    )  # fmt: skip
                write_page(out, workspace, objects)
    print(write_page(out, workspace, objects))


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
