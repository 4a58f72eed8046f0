"""Lightning DataModule over the training and validation splits of an export: crops of one object."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pytorch_lightning import LightningDataModule
from torch.utils.data import DataLoader

from rpl_data.torch.epochs import training_batches, validation_batches
from rpl_data.torch.keypoints import KeypointDataset, NoInstance
from rpl_data.torch.readable import collate_readable
from rpl_data.torch.scenes import hold_out_scenes
from rpl_data.torch.transforms import Augmentation
from rpl_data.types import DataError


class KeypointDataModule(LightningDataModule):
    """The train and val splits of an exported folder, for `Trainer.fit(model, data)`.

    A batch is a pair: the collated samples of `KeypointDataset` (the same keys with a leading batch axis;
    None when no image of the batch could be read), and a tuple of messages about images that could not be
    read.

    Attributes:
        train: the training set.
        val: the validation set; None where the folder has none or the object is not in it.
        scenes: which scenes are trained on and which are held out.
        unseen: the scenes that were held out, without augmentation; None without any.
    """

    def __init__(
        self,
        folder: str | Path,
        *,
        object: str | None = None,  # noqa: A002 (the recipe's and the CLI's word for it)
        input_px: int = 256,
        heatmap_px: int = 64,
        sigma_px: float = 1.0,
        batch: int = 16,
        augment: Augmentation | None = None,
        workers: int = 0,
        cache: bool = True,
        canonical: bool = False,
        validate_scenes: int = 0,
        seed: int = 0,
    ) -> None:
        """Read the annotations, and the pixels around the boxes when `cache`.

        Args:
            folder: folder of an export (export/coco or export/coco_truth).
            object: name of the object; may be left out when the dataset has one object.
            input_px, heatmap_px, sigma_px, cache, canonical: see `KeypointDataset`.
            batch: instances per step.
            workers: processes that load data; 0 loads in this process, which suits cached crops.
            validate_scenes: how many scenes of the training split are held out of training and validation,
                and are what `unseen` holds.
            seed: determines, together with the epoch alone, the order of the training instances and their
                augmentation.

        Raises:
            DataError: there is no training split, the object is not in it, it has no keypoints, or none is
                labelled.
        """
        super().__init__()
        sizes: dict[str, Any] = {"input_px": input_px, "heatmap_px": heatmap_px, "sigma_px": sigma_px}
        sizes |= {"object": object, "cache": cache, "canonical": canonical}
        folder = Path(folder).expanduser()
        self.scenes = hold_out_scenes(folder, validate_scenes, object=object)
        shown = self.scenes.trained
        self.train = KeypointDataset(folder, split="train", augment=augment, scenes=shown, **sizes)
        if not self.train.model.keypoints:
            raise DataError(
                f"{folder / 'train.json'}: {self.train.model.name} has no keypoints; name them in the recipe "
                "and click them"
            )
        if not self.train.labelled():
            raise DataError(
                f"{folder / 'train.json'}: no instance of {self.train.model.name} has a labelled keypoint: "
                "there is nothing to learn; click some, and export again"
            )
        self.val = _validation(folder / "val.json", {**sizes, "scenes": shown})
        unseen = self.scenes.unseen
        self.unseen = _validation(folder / "train.json", {**sizes, "scenes": unseen}) if unseen else None
        self._batch, self._workers, self._seed = batch, workers, seed

    def train_dataloader(self) -> DataLoader[Any]:
        """Batches of the training set, shuffled anew in every epoch."""
        # What Lightning gives `set_epoch`, a moment too late for worker processes.
        progress: Any = None if self.trainer is None else self.trainer.fit_loop.epoch_progress.current
        done = 0 if progress is None else progress.processed
        return training_batches(
            self.train,
            batch=self._batch,
            workers=self._workers,
            seed=self._seed,
            collate=collate_readable,
            epoch=done,
        )

    def val_dataloader(self) -> DataLoader[Any] | list[DataLoader[Any]]:
        """Batches of the validation set, in order, and of the unseen scenes; empty without any."""
        found = [
            validation_batches(each, batch=self._batch, workers=self._workers, collate=collate_readable)
            for each in (self.val, self.unseen)
            if each is not None
        ]
        return found[0] if len(found) == 1 else found


def _validation(coco_json: Path, sizes: dict[str, Any]) -> KeypointDataset | None:
    """Return the validation set; None when there is none."""
    if not coco_json.exists():
        return None
    try:
        return KeypointDataset(coco_json, **sizes)
    except NoInstance:
        return None
