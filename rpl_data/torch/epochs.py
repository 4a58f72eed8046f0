"""Training batches that depend only on the seed, the epoch and the row.

So a training run that was interrupted and resumed sees exactly what an uninterrupted one sees, however many
worker processes load the images.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence, Sized
from typing import Any

import numpy as np
import torch
from torch import distributed
from torch.utils.data import DataLoader, Dataset, Sampler

from rpl_data.torch.readable import Readable

Collate = Callable[[Sequence[Any]], Any]
"""Function that makes a batch of samples, some of which may be `Unreadable`."""


def seed_of(*key: int) -> int:
    """Derive a seed for torch from integers (>= 0), as if at random, but the same for the same ones."""
    return int(np.random.SeedSequence(key).generate_state(1, np.uint64)[0] >> 1)


class EpochOrder(Sampler[tuple[int, int]]):
    """Sampler of every row of a dataset once per epoch, shuffled by seed and epoch; yields (epoch, row).

    When several processes train together (DDP), each gets its share of the rows. Rows from the start of
    the order are repeated at its end, so that all shares are equally long.
    """

    def __init__(self, dataset: Sized, seed: int, epoch: int = 0) -> None:
        """Start at an epoch, counted from 0; `set_epoch` chooses another one."""
        self._dataset, self._seed, self._epoch = dataset, seed, epoch

    def set_epoch(self, epoch: int) -> None:
        """Choose the epoch, counted from 0, else epochs follow one another. Lightning calls this."""
        self._epoch = epoch

    def __len__(self) -> int:
        """Number of rows that this process gets per epoch."""
        return -(-len(self._dataset) // _processes()[1])

    def __iter__(self) -> Iterator[tuple[int, int]]:
        """Iterate over the rows of this process in this epoch."""
        epoch, self._epoch = self._epoch, self._epoch + 1
        return _OneEpoch(self, epoch)

    def rows(self, epoch: int) -> list[int]:
        """The rows of this process in an epoch, in their order."""
        order = np.random.default_rng((self._seed, epoch)).permutation(len(self._dataset))
        process, processes = _processes()
        shared: list[int] = np.resize(order, len(self) * processes)[process::processes].tolist()
        return shared


class _OneEpoch(Iterator[tuple[int, int]]):
    """The (epoch, row) of one epoch; torchdata's StatefulDataLoader saves where it is, and goes on there."""

    def __init__(self, order: EpochOrder, epoch: int) -> None:
        self._order, self._epoch, self._given = order, epoch, 0
        self._rows = order.rows(epoch)

    def __next__(self) -> tuple[int, int]:
        if self._given >= len(self._rows):
            raise StopIteration
        self._given += 1
        return self._epoch, self._rows[self._given - 1]

    def state_dict(self) -> dict[str, int]:
        """Where the iteration is: the epoch, and how many rows of it were given."""
        return {"epoch": self._epoch, "given": self._given}

    def load_state_dict(self, state: Mapping[str, int]) -> None:
        """Go on where a state was taken; the order follows with the next epoch."""
        self._epoch, self._given = state["epoch"], state["given"]
        self._rows = self._order.rows(self._epoch)
        self._order.set_epoch(self._epoch + 1)


def _processes() -> tuple[int, int]:
    """The number of this process (from 0), and the number of processes that train together."""
    if distributed.is_available() and distributed.is_initialized():
        return distributed.get_rank(), distributed.get_world_size()
    return 0, 1


class SeededRows(Dataset[Any]):
    """A dataset that draws from torch's random state, with that state set by seed, epoch and row.

    It is indexed by what `EpochOrder` yields, and leaves the random state as it found it.
    """

    def __init__(self, dataset: Any, seed: int) -> None:
        """Wrap a dataset that is indexed by row."""
        self._dataset, self._seed = dataset, seed

    def __len__(self) -> int:
        """Number of rows of the dataset."""
        return len(self._dataset)

    def __getitem__(self, epoch_and_row: tuple[int, int]) -> Any:
        """Return the sample of a row in an epoch."""
        epoch, row = epoch_and_row
        generator = torch.default_generator  # torch.manual_seed would reset the GPU's generator too
        before = generator.get_state()
        generator.manual_seed(seed_of(self._seed, epoch, row))
        try:
            return self._dataset[row]
        finally:
            generator.set_state(before)


def training_batches(
    dataset: Any,
    *,
    batch: int,
    workers: int,
    seed: int,
    collate: Collate,
    drop_last: bool = False,
    epoch: int = 0,
) -> DataLoader[Any]:
    """Make shuffled batches of a dataset with random augmentation; unreadable samples become `Unreadable`.

    Args:
        dataset: indexed by row.
        batch: samples per step and process.
        workers: processes that load samples; 0 loads them in this one.
        seed: of the order, and of all random numbers that the dataset draws.
        collate: makes a batch of samples and `Unreadable`s.
        drop_last: leave out the last batch of an epoch when it is smaller than the others.
        epoch: the first one, counted from 0. Where a training goes on, Lightning lets worker processes load
            the first batches before it calls `set_epoch`.
    """
    return DataLoader(
        Readable(SeededRows(dataset, seed)),
        batch_size=batch,
        sampler=EpochOrder(dataset, seed, epoch),
        num_workers=workers,
        persistent_workers=workers > 0,
        collate_fn=collate,
        drop_last=drop_last,
        pin_memory=torch.cuda.is_available(),
    )


def validation_batches(dataset: Any, *, batch: int, workers: int, collate: Collate) -> DataLoader[Any]:
    """Make batches of all samples of a dataset, in order; arguments as in `training_batches`."""
    return DataLoader(
        Readable(dataset),
        batch_size=batch,
        num_workers=workers,
        persistent_workers=workers > 0,
        collate_fn=collate,
        pin_memory=torch.cuda.is_available(),
    )
