"""The check of a GPU, run in little on the CPU; the GPU itself is another machine's."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from rpl_data.types import DataError
from rpl_data.workspace.workspace import Workspace
from training.device_check.record import Record
from training.device_check.speeds import Way
from training.device_check.trainings import refuse_another_end, refuse_loss_that_stays
from training.gpu_check import gpu_check, heatmap_difference


def test_the_check_runs_in_little(
    tiny_workspace: Workspace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "check.json"
    gpu_check(tiny_workspace.export("coco"), "carton", epochs=5, steps=1, out=out, little=True)
    printed = capsys.readouterr().out
    for word in ("heatmaps", "hourglass", "Mask R-CNN", "poses in val", "poses in test", "loss of carton"):
        assert word in printed
    measured = json.loads(out.read_text())
    assert measured["resumed_differs_by"] == 0 and "left_out" not in measured
    assert {row["network"] for row in measured["trainings"]} == {"hourglass", "resnet18"}
    assert {row["network"] for row in measured["speeds"]} == {"hourglass", "resnet18", "Mask R-CNN"}
    figures = measured["trainings"][0]["poses"]["test"]["with depth"]["carton consensus"]
    assert 0 <= figures["pck"] <= 1


def test_what_fails_and_what_there_is_no_time_for(tmp_path: Path) -> None:
    record = Record(tmp_path / "check.json", minutes=1.0)
    assert record.has_time("a row", 50) and not record.has_time("another", 70)
    record.add("trainings", {"network": "hourglass", "first": 4.0, "last": 2.1})
    with pytest.raises(DataError, match="expected 50% or less"):
        refuse_loss_that_stays(record)
    record.note(resumed_differs_by=1e-9)
    with pytest.raises(DataError, match="differ by 1.0e-09"):
        refuse_another_end(record)
    kept = json.loads((tmp_path / "check.json").read_text())
    assert kept["left_out"] == ["another"] and kept["trainings"][0]["last"] == 2.1


def test_what_is_left_out_has_a_plain_name() -> None:
    assert str(Way("resnet18", "bf16-mixed", channels_last=True)) == "resnet18, bf16-mixed, channels_last"


def test_too_few_epochs_for_a_loss_to_fall_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="--epochs is 1, --steps 30; expected at least 4"):
        gpu_check(tmp_path, epochs=1, little=True)


def test_heatmaps_are_compared_with_positions_outside_and_unknown() -> None:
    assert heatmap_difference(torch.device("cpu")) == 0


@pytest.mark.skipif(torch.cuda.is_available(), reason="says what is missing only where it is missing")
def test_without_a_gpu_it_says_so(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no CUDA GPU"):
        gpu_check(tmp_path)
