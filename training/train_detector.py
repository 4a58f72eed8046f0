"""Train the detector of all objects of a dataset: `rpl train detector --help`."""

from __future__ import annotations

import sys
from collections.abc import Collection
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
    weights: str = "scratch",
    validate_scenes: int = 0,
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
        weights: what the training starts from: `scratch`; `imagenet` (torchvision fetches it; for fcos); or
            the path of a file: a network of torchvision's, or a checkpoint of this program, also of other
            objects.
        validate_scenes: how many scenes of the training split to hold out and validate on, beside the random
            frames of val: best.ckpt then goes by these unseen scenes. The test split is never looked at.
        validate_every: epochs from one validation to the next, and after the last; 0 never validates.
        seed: of everything that is drawn at random.
        resume: go on with the run in `out`, after its last finished epoch.
        overwrite: delete the run in `out` and start anew.
        until: stop after this epoch; the learning rate still follows learning.epochs.
    """
    from rpl_data.torch.detection import DetectionDataset
    from rpl_data.torch.readable import collate_readable_lists
    from rpl_data.torch.scenes import hold_out_scenes
    from rpl_data.torch.splits import refuse_no_labels

    from .detection.module import load_detector, start_of, untrained_detector
    from .runs.folder import HELD_OUT, check_same_network
    from .runs.trainer import Lesson, fit, say, say_held_out, start
    from .runs.weights import start_from

    coco = coco.expanduser()
    run = Run(out, learning, machine, validate_every, seed, resume, overwrite, until)
    resumed = start(run)
    scenes = hold_out_scenes(coco, validate_scenes)
    train = DetectionDataset(
        coco, split="train", width_px=network.width_px, augment=augment, scenes=scenes.trained
    )
    refuse_no_labels(train.labelled(), coco / "train.json")
    val = _validation(coco / "val.json", network, scenes.trained)
    unseen = _validation(coco / "train.json", network, scenes.unseen) if scenes.unseen else None
    module = untrained_detector(train.names, network, learning)
    if resumed is None:
        say(start_from(start_of(module), weights))
    else:
        trained = load_detector(resumed)
        check_same_network(resumed, (trained.names, trained.options), (module.names, network))
    say(f"{', '.join(train.names[1:])}: {len(train)} images to train on, {len(val or [])} to validate on")
    say_held_out(scenes, len(unseen or []))
    settings = {"augment": asdict(augment), "weights": weights, HELD_OUT: list(scenes.unseen)}
    lesson = Lesson(
        coco / "train.json", module, train, val, collate_readable_lists, "found", settings, unseen=unseen
    )
    return fit(lesson, run, resumed=resumed)


def _validation(
    coco_json: Path, network: DetectorNetwork, scenes: Collection[str] | None
) -> DetectionDataset | None:
    """None where there is nothing to validate on."""
    from rpl_data.formats.datasets.coco_parts import read_packed
    from rpl_data.torch.detection import DetectionDataset
    from rpl_data.torch.scenes import LOOKED_AT, only_scenes

    if not coco_json.exists() or not only_scenes(read_packed(coco_json, LOOKED_AT), scenes)["images"]:
        return None
    return DetectionDataset(coco_json, width_px=network.width_px, scenes=scenes)


if __name__ == "__main__":
    from .runs.program import main

    sys.exit(main(train_detector, presets=True))
