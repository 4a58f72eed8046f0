"""Train the keypoint network of one object: `rpl train keypoints --help`."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rpl_data.torch.transforms import Augmentation
from rpl_data.types import DataError

from .runs.options import Learning, Machine, Network, Run

TYPE_CHECKING = False  # not typing's: the parser of the options would import what follows, torch and all
if TYPE_CHECKING:
    from .keypoints.module import KeypointTraining


def train_keypoints(
    coco: Path,
    object: str | None = None,  # noqa: A002 (the recipe's and the CLI's word for it)
    out: Path = Path("runs/keypoints"),
    network: Network = Network(),  # noqa: B008 (frozen)
    learning: Learning = Learning(),  # noqa: B008
    augment: Augmentation = Augmentation(),  # noqa: B008
    machine: Machine = Machine(),  # noqa: B008
    cache: bool = True,
    canonical: bool = False,
    weights: str = "scratch",
    validate_scenes: int = 0,
    synthetic: float = 0.0,
    rendered: Path | None = None,
    validate_every: int = 1,
    seed: int = 0,
    resume: bool = False,
    overwrite: bool = False,
    until: int | None = None,
) -> Path:
    """Train a keypoint network on one object; the path of its last checkpoint comes back.

    Presets: --config keypoints_paper (for a GPU) or keypoints_cpu (minutes on a CPU), or a YAML file of your
    own; options after it win. For example: rpl train keypoints my-workspace/export/coco --object cube
    --config keypoints_cpu. Writes last.ckpt after every epoch, best.ckpt (the highest val_pck), and CSV and
    TensorBoard logs. Interrupt it whenever you like: --resume true goes on after the last finished epoch.

    Args:
        coco: folder that `rpl export` wrote: export/coco, or export/coco_truth for true labels.
        object: name of the object; may be left out when the dataset has one object.
        out: folder of the run.
        network: which network, its size, its input and its loss.
        learning: how long and how fast it is trained.
        augment: how far training crops may stray from the box.
        machine: the hardware.
        cache: keep the decoded pixels around the boxes in memory.
        canonical: teach all poses of a symmetric object that look the same as one, by the symmetries that
            `rpl symmetry` found and you confirmed. Then evaluate by `rpl evaluate poses --symmetric true`.
        weights: what the training starts from: `scratch`; `imagenet` (torchvision fetches it; for the
            architectures that are torchvision's); or the path of a file: a network of torchvision's, or a
            checkpoint of this program, also of another object.
        validate_scenes: how many scenes of the training split to hold out and validate on, beside the random
            frames of val: best.ckpt then goes by these unseen scenes. The test split is never looked at.
        synthetic: share of the training crops that is rendered anew in every epoch, 0 to 1, of what
            `rpl synthesize` made of the training scenes. They are augmented as recorded crops are, but for
            augment.occluders and augment.backgrounds.
        rendered: the folder that it wrote; export/synthetic beside `coco` when left out.
        validate_every: epochs from one validation to the next, and after the last; 0 never validates.
        seed: of everything that is drawn at random.
        resume: go on with the run in `out`, after its last finished epoch.
        overwrite: delete the run in `out` and start anew.
        until: stop after this epoch; the learning rate still follows learning.epochs.
    """
    from rpl_data.synthesize.storage import studio_hash
    from rpl_data.torch.datamodule import KeypointDataModule
    from rpl_data.torch.partly_synthetic import partly_synthetic
    from rpl_data.torch.readable import collate_readable

    from .keypoints.module import untrained
    from .keypoints.networks import start_of
    from .runs.folder import HELD_OUT
    from .runs.trainer import Lesson, fit, say, say_held_out, start
    from .runs.weights import start_from

    refuse_contradictions(synthetic, rendered, validate_scenes)
    coco = coco.expanduser()
    run = Run(out, learning, machine, validate_every, seed, resume, overwrite, until)
    resumed = start(run)
    data = KeypointDataModule(
        coco,
        object=object,
        input_px=network.input_px,
        heatmap_px=network.heatmap_px,
        sigma_px=network.sigma_px,
        augment=augment,
        cache=cache,
        canonical=canonical,
        validate_scenes=validate_scenes,
    )
    module = untrained(data.train.model, network, learning)
    if resumed is None:
        say(start_from(start_of(module.network, network), weights))
    else:
        check_resumable(resumed, module)
    train: Any = data.train
    folder = (rendered or coco.parent / "synthetic").expanduser() if synthetic else None
    if folder is not None:
        train = partly_synthetic(data.train, folder, synthetic, canonical=canonical)
    counts = f"{len(data.train)} instances to train on, {len(data.val or [])} to validate on"
    say(f"{data.train.model.name}: {counts}")
    if synthetic:
        say(f"{synthetic:.0%} of the crops are rendered anew in every epoch, of {folder}")
    say_held_out(data.scenes, len(data.unseen or []))
    settings = {
        "augment": asdict(data.train.augment or augment),
        "canonical": canonical,
        "weights": weights,
        HELD_OUT: list(data.scenes.unseen),
        "synthetic": synthetic,
        "rendered": None if folder is None else studio_hash(folder)[:12],
    }
    lesson = Lesson(
        coco / "train.json", module, train, data.val, collate_readable, "pck", settings, unseen=data.unseen,
        rendered_json=None if folder is None else folder / "train.json",
    )  # fmt: skip
    return fit(lesson, run, resumed=resumed)


def refuse_contradictions(synthetic: float, rendered: Path | None, validate_scenes: int) -> None:
    """Raise a DataError where options about rendered crops do not go together, before anything is read."""
    if not 0 <= synthetic <= 1:
        raise DataError(f"--synthetic is {synthetic}; give the share of rendered crops, 0 to 1")
    if rendered is not None and not synthetic:
        raise DataError("--rendered names what nothing uses; say by --synthetic which share is rendered")
    if synthetic and validate_scenes:
        raise DataError(
            "--synthetic renders what all training scenes show, those that --validate_scenes holds out too, "
            "so they would not be unseen; leave one of the two out"
        )


def check_resumable(checkpoint: Path, module: KeypointTraining) -> None:
    """Refuse a checkpoint of another object or network with a DataError."""
    from .keypoints.module import check_same_object, load_keypoints
    from .runs.folder import check_same_network

    trained = load_keypoints(checkpoint)
    check_same_object(trained, module.model, source=str(checkpoint))
    check_same_network(checkpoint, trained.options, module.options)


if __name__ == "__main__":
    from .runs.program import main

    sys.exit(main(train_keypoints, presets=True))
