"""Batches that follow from seed, epoch and row alone, also after an interruption within an epoch."""

import copy

import pytest
import torch
from torch.utils.data import Dataset

from rpl_data.torch.epochs import EpochOrder, SeededRows


class Drawing(Dataset):
    """Rows whose samples are drawn from torch's random state."""

    def __len__(self):
        return 10

    def __getitem__(self, row):
        return torch.stack([torch.tensor(float(row)), torch.rand(())])


def test_an_epoch_has_every_row_once_and_its_own_order():
    order = EpochOrder(Drawing(), seed=1)
    first, second = list(order), list(order)
    assert sorted(row for _, row in first) == sorted(row for _, row in second) == list(range(10))
    assert {epoch for epoch, _ in first} == {0} and {epoch for epoch, _ in second} == {1}
    assert [row for _, row in first] != [row for _, row in second]


def test_an_iteration_goes_on_where_its_state_was_taken():
    whole = iter(EpochOrder(Drawing(), seed=1, epoch=2))
    before = [next(whole) for _ in range(4)]
    state = copy.deepcopy(whole.state_dict())
    rest = list(whole)
    assert len(before) + len(rest) == 10
    again = EpochOrder(Drawing(), seed=1)
    there = iter(again)
    there.load_state_dict(state)
    assert list(there) == rest
    assert next(iter(again))[0] == 3  # the next epoch follows


@pytest.mark.parametrize("workers", [0, 2])
def test_a_stateful_loader_resumes_with_the_same_augmentation(workers):
    loading = pytest.importorskip(
        "torchdata.stateful_dataloader", reason="torchdata (StatefulDataLoader) is not installed"
    )

    def loader():
        rows = SeededRows(Drawing(), seed=5)
        order = EpochOrder(rows, seed=5)
        return loading.StatefulDataLoader(rows, batch_size=3, sampler=order, num_workers=workers)

    whole = loader()
    expected = [batch for _ in range(3) for batch in whole]  # three epochs of four batches
    interrupted = loader()
    list(interrupted)
    second = iter(interrupted)
    seen = [next(second) for _ in range(2)]
    state = interrupted.state_dict()
    del second, interrupted
    torch.manual_seed(99)  # another process has another state
    resumed = loader()
    resumed.load_state_dict(state)
    rest = [*resumed, *resumed]  # the second epoch's end, and the third
    assert torch.equal(torch.cat([*seen, *rest]), torch.cat(expected[4:]))
