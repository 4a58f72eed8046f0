"""What a training does beside its steps: averaged weights, an early end, the strict judge, time left."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from labelled_scenes import BOX, labelled_scene
from torch import nn

from rpl_data.export import export_coco
from rpl_data.export.split import SplitRule
from rpl_data.types import DataError
from training.runs.averaging import WeightAverage
from training.runs.callbacks import refuse_idle_patience, time_left
from training.runs.folder import read_checkpoint, trained_epochs
from training.runs.options import Learning, Machine, Network, Run
from training.runs.program import use_threads
from training.train_keypoints import train_keypoints

ONE = Machine(accelerator="cpu", threads=1, deterministic=True)
TINY = Network(stacks=1, features=16, levels=2, input_px=32, heatmap_px=8, loss="entropy")


def test_the_average_is_the_recursion_of_its_docstring() -> None:
    module = nn.Sequential(nn.Linear(2, 2), nn.BatchNorm1d(2))
    average = WeightAverage(0.5)
    average.on_train_start(None, module)  # type: ignore[arg-type]  # a module is all that is looked at
    expected = module[0].weight.detach().clone()
    for step in range(1, 12):
        with torch.no_grad():
            module[0].weight += step
            module[1].num_batches_tracked += 1
        average.on_train_batch_end(None, module, None, None, 0)  # type: ignore[arg-type]
        kept = min(0.5, (1 + step) / (10 + step))
        expected = kept * expected + (1 - kept) * module[0].weight.detach()
    last = module[0].weight.detach().clone()
    average.on_validation_start(None, module)  # type: ignore[arg-type]
    torch.testing.assert_close(module[0].weight.detach(), expected)
    assert module[1].num_batches_tracked == 11
    average.on_validation_end(None, module)  # type: ignore[arg-type]
    assert torch.equal(module[0].weight.detach(), last)


def test_best_goes_by_unseen_scenes_and_a_training_in_vain_ends(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenes = [labelled_scene(tmp_path / "recording", name, objects=(BOX,)) for name in "ab"]
    export_coco(tmp_path / "coco", scenes, [BOX], split=SplitRule(test_scenes=0, val_fraction=0.3))
    still = Learning(epochs=9, batch=4, optimizer="adam", rate=1e-12, patience=2)  # no step is felt
    out = tmp_path / "run"
    more = {"network": TINY, "learning": still, "machine": ONE, "validate_scenes": 1}
    train_keypoints(tmp_path / "coco", None, out, **more)
    said = capsys.readouterr().out
    assert "held out, to choose the best by: b" in said
    assert "val_pck" in said and "stops: val_scenes_pck is no better after 2 validations" in said
    done = trained_epochs(out / "last.ckpt")
    assert trained_epochs(out / "best.ckpt") + 2 == done < 9
    train_keypoints(tmp_path / "coco", None, out, **more, resume=True)
    assert trained_epochs(out / "last.ckpt") == done  # not an epoch more
    with pytest.raises(DataError, match="held_out_scenes .*'b'.*, asked for is"):
        train_keypoints(tmp_path / "coco", None, out, **more | {"validate_scenes": 0}, resume=True)


def test_patience_needs_validations() -> None:
    with pytest.raises(DataError, match="counts validations"):
        Run(Path("run"), Learning(patience=3), ONE, validate_every=0)
    refuse_idle_patience(Learning(patience=3), can_validate=True)
    with pytest.raises(DataError, match="no images to validate on"):
        refuse_idle_patience(Learning(patience=3), can_validate=False)


def test_what_is_no_number_or_no_checkpoint_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="learning.rate must be above 0"):
        Learning(rate=float("nan"))
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(DataError, match="as weights: it is damaged, or something else wrote it"):
        read_checkpoint(tmp_path / "notes.txt")


def test_no_threads_are_refused() -> None:
    with pytest.raises(DataError, match="--threads is 0; give 1 or more"):
        use_threads(0)


@pytest.mark.parametrize(
    ("seconds", "said"), [(7.4, "7 s"), (130, "2 min"), (3 * 3600 + 20 * 60, "3 h 20 min")]
)
def test_time_left_as_a_person_says_it(seconds: float, said: str) -> None:
    assert time_left(seconds) == said
