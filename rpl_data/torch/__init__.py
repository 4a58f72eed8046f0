"""PyTorch Datasets over an exported folder, and what a training loop of your own needs beside them.

::

    from rpl_data.torch import Augmentation, KeypointDataset

    train = KeypointDataset("my-workspace/export/coco", split="train", augment=Augmentation())
    train[0]["image"].shape, train[0]["heatmaps"].shape     # (3, 256, 256), (k, 64, 64)

Datasets: `KeypointDataset` (crops of one object with heatmaps, for the paper's hourglass), `InstanceDataset`
(whole images with boxes and masks, for Mask R-CNN), `DetectionDataset` (small images with the paper's square
boxes), `SyntheticKeypoints` (crops rendered while training, of what `rpl synthesize` made), and
`KeypointDataModule` for Lightning. `help` on each names keys, shapes, types and units.

From heatmaps to a pose: `locate` reads keypoints off heatmaps, `positions_in_image` takes them to the full
image, `correspondences` pairs them with the model and `estimate_pose` (EPnP and others) solves for the pose.
`examples/train_in_your_own_loop.py` does it all.

Names are loaded when first used. Nothing here needs the rest of rpl_data.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rpl_data.pose.correspondences import correspondences as correspondences
    from rpl_data.pose.estimate import PoseEstimate as PoseEstimate
    from rpl_data.pose.estimate import PoseFailure as PoseFailure
    from rpl_data.pose.estimate import estimate_pose as estimate_pose
    from rpl_data.torch.adapters import from_albumentations as from_albumentations
    from rpl_data.torch.adapters import from_kornia as from_kornia
    from rpl_data.torch.augmentation import Augmentation as Augmentation
    from rpl_data.torch.datamodule import KeypointDataModule as KeypointDataModule
    from rpl_data.torch.decoding import Keypoints as Keypoints
    from rpl_data.torch.decoding import locate as locate
    from rpl_data.torch.decoding import probabilities as probabilities
    from rpl_data.torch.detection import DetectionDataset as DetectionDataset
    from rpl_data.torch.detection import DetectionTarget as DetectionTarget
    from rpl_data.torch.epochs import EpochOrder as EpochOrder
    from rpl_data.torch.epochs import SeededRows as SeededRows
    from rpl_data.torch.heatmaps import draw_heatmaps as draw_heatmaps
    from rpl_data.torch.heatmaps import positions_in_image as positions_in_image
    from rpl_data.torch.instances import InstanceDataset as InstanceDataset
    from rpl_data.torch.instances import InstanceSample as InstanceSample
    from rpl_data.torch.instances import InstanceTarget as InstanceTarget
    from rpl_data.torch.instances import collate as collate
    from rpl_data.torch.keypoints import KeypointDataset as KeypointDataset
    from rpl_data.torch.keypoints import KeypointSample as KeypointSample
    from rpl_data.torch.partly_synthetic import PartlySynthetic as PartlySynthetic
    from rpl_data.torch.synthetic import SyntheticKeypoints as SyntheticKeypoints
    from rpl_data.torch.targets import settled as settled
    from rpl_data.torch.warps import RandomAffine as RandomAffine
    from rpl_data.types import Intrinsics as Intrinsics

_MODULE_OF = {
    "Augmentation": "rpl_data.torch.augmentation",
    "DetectionDataset": "rpl_data.torch.detection",
    "DetectionTarget": "rpl_data.torch.detection",
    "EpochOrder": "rpl_data.torch.epochs",
    "InstanceDataset": "rpl_data.torch.instances",
    "InstanceSample": "rpl_data.torch.instances",
    "InstanceTarget": "rpl_data.torch.instances",
    "Intrinsics": "rpl_data.types",
    "KeypointDataModule": "rpl_data.torch.datamodule",
    "KeypointDataset": "rpl_data.torch.keypoints",
    "KeypointSample": "rpl_data.torch.keypoints",
    "Keypoints": "rpl_data.torch.decoding",
    "PartlySynthetic": "rpl_data.torch.partly_synthetic",
    "PoseEstimate": "rpl_data.pose.estimate",
    "PoseFailure": "rpl_data.pose.estimate",
    "RandomAffine": "rpl_data.torch.warps",
    "SeededRows": "rpl_data.torch.epochs",
    "SyntheticKeypoints": "rpl_data.torch.synthetic",
    "collate": "rpl_data.torch.instances",
    "correspondences": "rpl_data.pose.correspondences",
    "draw_heatmaps": "rpl_data.torch.heatmaps",
    "estimate_pose": "rpl_data.pose.estimate",
    "from_albumentations": "rpl_data.torch.adapters",
    "from_kornia": "rpl_data.torch.adapters",
    "locate": "rpl_data.torch.decoding",
    "positions_in_image": "rpl_data.torch.heatmaps",
    "probabilities": "rpl_data.torch.decoding",
    "settled": "rpl_data.torch.targets",
}

__all__ = [
    "Augmentation",
    "DetectionDataset",
    "DetectionTarget",
    "EpochOrder",
    "InstanceDataset",
    "InstanceSample",
    "InstanceTarget",
    "Intrinsics",
    "KeypointDataModule",
    "KeypointDataset",
    "KeypointSample",
    "Keypoints",
    "PartlySynthetic",
    "PoseEstimate",
    "PoseFailure",
    "RandomAffine",
    "SeededRows",
    "SyntheticKeypoints",
    "collate",
    "correspondences",
    "draw_heatmaps",
    "estimate_pose",
    "from_albumentations",
    "from_kornia",
    "locate",
    "positions_in_image",
    "probabilities",
    "settled",
]


def __getattr__(name: str) -> Any:
    """Load a name when it is first used (PEP 562)."""
    if name not in _MODULE_OF:
        raise AttributeError(
            f"module 'rpl_data.torch' has no attribute {name!r}; it has {', '.join(__all__)}"
        )
    from importlib import import_module

    try:
        module = import_module(_MODULE_OF[name])
    except ModuleNotFoundError as error:
        if error.name != "pytorch_lightning":
            raise
        raise ImportError(f"{name} needs PyTorch Lightning: pip install 'rpl-data[training]'") from error
    value = globals()[name] = getattr(module, name)
    return value


def __dir__() -> list[str]:
    """What there is to complete."""
    return list(__all__)
