"""Train Mask R-CNN on all objects of a dataset: `rpl train masks --help`."""

from __future__ import annotations

import sys
from collections.abc import Collection
from dataclasses import asdict
from pathlib import Path

from rpl_data.torch.transforms import Augmentation

from .masks.settings import AUGMENT, LEARNING, MACHINE, OLD_NAMES, MaskSettings
from .runs.options import Learning, Machine, MaskNetwork, Run

TYPE_CHECKING = False  # not typing's: the parser of the options would import what follows, torch and all
if TYPE_CHECKING:
    from rpl_data.torch.instances import InstanceDataset

    from .masks.module import MaskTraining


def train_masks(
    coco: Path,
    out: Path = Path("runs/masks"),
    network: MaskNetwork = MaskNetwork(),  # noqa: B008 (frozen)
    learning: Learning = LEARNING,
    augment: Augmentation = AUGMENT,
    machine: Machine = MACHINE,
    weights: str = "imagenet",
    head_epochs: int = 20,
    validate_scenes: int = 0,
    validate_every: int = 1,
    seed: int = 0,
    resume: bool = False,
    overwrite: bool = False,
    until: int | None = None,
) -> Path:
    """Train Mask R-CNN on all objects; the path of its last checkpoint comes back.

    Presets: --config masks_paper (for a GPU) or masks_cpu (small, on a CPU), or a YAML file of your own;
    options after it win. For example: rpl train masks my-workspace/export/coco --config masks_cpu. Writes
    last.ckpt after every epoch, best.ckpt (the highest val_iou), and CSV and TensorBoard logs. Interrupt it
    whenever you like: --resume true goes on after the last finished epoch.

    Args:
        coco: folder that `rpl export` wrote: export/coco, or export/coco_truth for true labels.
        out: folder of the run.
        network: size of the network.
        learning: how long and how fast it is trained.
        augment: how far the square training crops may stray; shift may take them over the image's edge.
        machine: the hardware.
        weights: what the training starts from: `scratch`, `imagenet` (torchvision fetches it), or the path of
            trained weights: a ResNet's, a torchvision Mask R-CNN's, or a checkpoint of this program.
        head_epochs: how many epochs, from the first one, the ResNet is frozen (the paper's first stage).
        validate_scenes: how many scenes of the training split to hold out and validate on, beside the random
            frames of val: best.ckpt then goes by these unseen scenes. The test split is never looked at.
        validate_every: epochs from one validation to the next, and after the last; 0 never validates.
        seed: of everything that is drawn at random.
        resume: go on with the run in `out`, after its last finished epoch.
        overwrite: delete the run in `out` and start anew.
        until: stop after this epoch; the learning rate still follows learning.epochs.
    """
    from rpl_data.torch.readable import collate_readable_lists
    from rpl_data.torch.scenes import hold_out_scenes
    from rpl_data.torch.splits import split_file

    from .masks.crops import SquareCrops
    from .masks.mask_rcnn import with_norm
    from .masks.module import MaskTraining
    from .masks.weights import load_weights
    from .runs.folder import HELD_OUT
    from .runs.trainer import Lesson, fit, say, say_held_out, start

    MaskSettings(learning=learning, head_epochs=head_epochs)  # refuses stages that do not fit
    coco = coco.expanduser()
    run = Run(out, learning, machine, validate_every, seed, resume, overwrite, until)
    resumed = start(run)
    network = with_norm(network, weights)
    scenes = hold_out_scenes(coco, validate_scenes)
    train_json = split_file(coco, "train")
    train = SquareCrops(train_json, network.size_px, augment, scenes.trained)
    val = _validation(coco / "val.json", scenes.trained)
    unseen = _validation(train_json, scenes.unseen) if scenes.unseen else None
    module = MaskTraining(train.names, network, learning, head_epochs=head_epochs)
    if resumed is None:
        say(load_weights(module.model, network, weights))
    else:
        check_resumable(resumed, module)
    say(f"{', '.join(train.names[1:])}: {len(train)} images to train on, {len(val or [])} to validate on")
    say_held_out(scenes, len(unseen or []))
    settings = {"augment": asdict(augment), "weights": weights, "head_epochs": head_epochs}
    lesson = Lesson(
        train_json,
        module,
        train,
        val,
        collate_readable_lists,
        "iou",
        settings | {HELD_OUT: list(scenes.unseen)},
        unseen=unseen,
        drop_last=len(train) > learning.batch,  # batch norm learns little from a last batch of one image
        val_batch=1,  # whole images are larger than the training's crops
    )
    return fit(lesson, run, resumed=resumed)


def _validation(coco_json: Path, scenes: Collection[str] | None) -> InstanceDataset | None:
    """None where there is nothing to validate on."""
    from rpl_data.torch.instances import InstanceDataset

    dataset = InstanceDataset(coco_json, crowds=True, scenes=scenes) if coco_json.exists() else None
    return dataset if dataset is not None and len(dataset) else None


def check_resumable(checkpoint: Path, module: MaskTraining) -> None:
    """Refuse a checkpoint of other classes or another network with a DataError."""
    from .masks.weights import load_segmenter
    from .runs.folder import check_same_network

    trained = load_segmenter(checkpoint)
    check_same_network(checkpoint, (trained.names, trained.network), (module.names, module.network))


if __name__ == "__main__":
    from .runs.program import main

    sys.exit(main(train_masks, old_names=OLD_NAMES, presets=True))
