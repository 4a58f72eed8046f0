"""The check of a GPU, run in little on the CPU; the GPU itself is another machine's."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from rpl_data.types import DataError
from rpl_data.workspace.workspace import Workspace
from training.gpu_check import gpu_check, heatmap_difference


def test_the_check_runs_in_little(tiny_workspace: Workspace, capsys: pytest.CaptureFixture[str]) -> None:
    coco = tiny_workspace.export("coco")
    gpu_check(coco, "carton", epochs=8, steps=1, little=True)
    printed = capsys.readouterr().out
    for word in ("heatmaps", "hourglass", "Mask R-CNN", "poses in val", "poses in test", "loss of carton"):
        assert word in printed
    with pytest.raises(DataError, match="expected 50% or less"):
        gpu_check(coco, "carton", epochs=1, steps=1, little=True)  # one epoch cannot have fallen


def test_heatmaps_are_compared_with_positions_outside_and_unknown() -> None:
    assert heatmap_difference(torch.device("cpu")) == 0


@pytest.mark.skipif(torch.cuda.is_available(), reason="says what is missing only where it is missing")
def test_without_a_gpu_it_says_so(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no CUDA GPU"):
        gpu_check(tmp_path)
