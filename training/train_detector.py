"""Train the detector of all objects of a dataset: `rpl train detector --help`."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path

from rpl_data.torch.transforms import Augmentation

from .runs.options import DetectorNetwork, Learning, Machine, Run

TYPE_CHECKING = False  # not typing's: the parser of the options would import what follows, torch and all
if TYPE_CHECKING:
    from rpl_data.torch.detection import DetectionDataset

UPRIGHT = Augmentation(rotation_deg=0.0)


def train_detector(
    coco: Path,
    out: Path = Path("runs/detector"),
    network: DetectorNetwork = DetectorNetwork(),  # noqa: B008 (frozen)
    learning: Learning = Learning(),  # noqa: B008
    augment: Augmentation = UPRIGHT,
    machine: Machine = Machine(),  # noqa: B008
    validate_every: int = 1,
    seed: int = 0,
    resume: bool = False,
    overwrite: bool = False,
    until: int | None = None,
) -> Path:
    """Train one detector on all objects; the path of its last checkpoint comes back.

    Presets: --config detector_paper (for a GPU) or detector_cpu (minutes on a CPU), or a YAML file of your
    own; options after it win. For example: rpl train detector my-workspace/export/coco --config detector_cpu.
    Writes last.ckpt after every epoch, best.ckpt (the highest val_found), and CSV and TensorBoard logs.
    Interrupt it whenever you like: --resume true goes on after the last finished epoch.

    Args:
        coco: folder that `rpl export` wrote: export/coco, or export/coco_truth for true labels.
        out: folder of the run.
        network: which detector, and how large.
        learning: how long and how fast it is trained.
        augment: shift (a share of the image's width), scale and colours; rotation_deg must be 0.
        machine: the hardware.
        validate_every: epochs from one validation to the next; 0 never validates.
        seed: of everything that is drawn at random.
        resume: go on with the run in `out`, after its last finished epoch.
        overwrite: delete the run in `out` and start anew.
        until: stop after this epoch; the learning rate still follows learning.epochs.
    """
    from rpl_data.torch.detection import DetectionDataset
    from rpl_data.torch.readable import collate_readable_lists

    from .detection.module import load_detector, untrained_detector
    from .runs.folder import check_same_network
    from .runs.trainer import Lesson, fit, say, start

    run = Run(out, learning, machine, validate_every, seed, resume, overwrite, until)
    resumed = start(run)
    train = DetectionDataset(coco, split="train", width_px=network.width_px, augment=augment)
    val = _validation(coco / "val.json", network)
    module = untrained_detector(train.names, network, learning)
    if resumed is not None:
        trained = load_detector(resumed)
        check_same_network(resumed, (trained.names, trained.options), (module.names, network))
    say(f"{', '.join(train.names[1:])}: {len(train)} images to train on, {len(val or [])} to validate on")
    lesson = Lesson(
        module,
        module.unreadable,
        train,
        val,
        collate=collate_readable_lists,
        monitor="val_found",
        settings={"augment": asdict(augment)},
    )
    return fit(lesson, run, resumed=resumed)


def _validation(coco_json: Path, network: DetectorNetwork) -> DetectionDataset | None:
    """None where there is nothing to validate on."""
    from rpl_data.formats.datasets.coco import read_coco
    from rpl_data.torch.detection import DetectionDataset

    if not coco_json.exists() or not read_coco(coco_json)["images"]:
        return None
    return DetectionDataset(coco_json, width_px=network.width_px)


if __name__ == "__main__":
    from .runs.program import main

    sys.exit(main(train_detector, presets=True))
