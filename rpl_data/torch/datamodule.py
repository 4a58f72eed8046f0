"""An exported dataset's splits as a Lightning DataModule of one object's crops."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pytorch_lightning import LightningDataModule
from torch.utils.data import DataLoader

from rpl_data.torch.keypoints import KeypointDataset
from rpl_data.torch.readable import Readable, collate_readable
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
    ) -> None:
        """Read the annotations, and the pixels about the boxes when `cache`.

        Args:
            folder: of `rpl export`: export/coco or export/coco_truth.
            object: its name; may be left out when the dataset has one object.
            input_px, heatmap_px, sigma_px, augment, cache: of `KeypointDataset`; `augment` is for training.
            batch: instances a step.
            workers: processes that load; 0 = none, which suits cached crops.

        Raises:
            DataError: there is no training split, the object is not in it, or it has no keypoints.
        """
        super().__init__()
        sizes: dict[str, Any] = {"input_px": input_px, "heatmap_px": heatmap_px, "sigma_px": sigma_px}
        sizes |= {"object": object, "cache": cache}
        folder = Path(folder).expanduser()
        self.train = KeypointDataset(folder, split="train", augment=augment, **sizes)
        if not self.train.model.keypoints:
            raise DataError(
                f"{folder / 'train.json'}: {self.train.model.name} has no keypoints; name them in the recipe "
                "and click them"
            )
        self.val = _validation(folder / "val.json", sizes)
        self._batch, self._workers = batch, workers

    def train_dataloader(self) -> DataLoader[Any]:
        """Shuffled."""
        return self._loader(self.train, shuffle=True)

    def val_dataloader(self) -> DataLoader[Any] | list[Any]:
        """In order; empty without a validation set."""
        return [] if self.val is None else self._loader(self.val, shuffle=False)

    def _loader(self, dataset: KeypointDataset, *, shuffle: bool) -> DataLoader[Any]:
        return DataLoader(
            Readable(dataset),
            batch_size=self._batch,
            shuffle=shuffle,
            num_workers=self._workers,
            persistent_workers=self._workers > 0,
            collate_fn=collate_readable,
        )


def _validation(coco_json: Path, sizes: dict[str, Any]) -> KeypointDataset | None:
    """None where there is nothing to validate on; training goes on without."""
    if not coco_json.exists():
        return None
    try:
        return KeypointDataset(coco_json, **sizes)
    except DataError as error:
        if "no instance" in str(error):
            return None
        raise
