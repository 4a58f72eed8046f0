"""A run that was interrupted ends with the weights of one that was not; folders are never mixed up."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from labelled_scenes import exported

from rpl_data.synthesize.storage import studio_hash
from rpl_data.types import DataError
from training.runs.callbacks import Steps
from training.runs.checkpoint_files import WholeCheckpoints, sweep_checkpoints
from training.runs.folder import (
    LOCK,
    alone_in_folder,
    changes,
    checkpoint_to_resume,
    delete_run,
    read_checkpoint,
    settings_of,
    trained_epochs,
)
from training.runs.options import DetectorNetwork, Learning, Machine, MaskNetwork, Network, Run
from training.runs.program import main
from training.runs.schedule import learning_rate, optimizer_of, set_step
from training.runs.trainer import start
from training.train_detector import train_detector
from training.train_keypoints import train_keypoints
from training.train_masks import train_masks

ONE = Machine(accelerator="cpu", threads=1)
CYCLE = Learning(epochs=3, batch=2, optimizer="adam", rate=2e-3, schedule="one_cycle")
AVERAGED = replace(CYCLE, ema=0.9)
HOURGLASS = Network(stacks=1, features=16, levels=2, input_px=32, heatmap_px=8, loss="entropy")
MASKS = MaskNetwork(
    backbone="resnet18", size_px=64, stages=3, channels=32, hidden=32, proposals=50, rois=16, norm="group"
)
STAGED = Learning(epochs=3, batch=2, optimizer="adamw", rate=1e-3, warmup_steps=2, cooldown=0.5, clip=5.0)

TRAININGS: dict[str, Callable[..., Path]] = {
    "keypoints": lambda coco, out, **more: train_keypoints(
        coco, "box", out, **{"network": HOURGLASS, "learning": AVERAGED, "machine": ONE, **more}
    ),
    "detector": lambda coco, out, **more: train_detector(
        coco,
        out,
        **{"network": DetectorNetwork(width_px=64, features=32), "learning": CYCLE, "machine": ONE, **more},
    ),
    "masks": lambda coco, out, **more: train_masks(
        coco,
        out,
        **{
            "network": MASKS,
            "learning": STAGED,
            "weights": "scratch",
            "head_epochs": 1,
            "machine": ONE,
            **more,
        },
    ),
}


@pytest.fixture(scope="module")
def coco(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two objects in a few images, some of which are for validation."""
    return exported(tmp_path_factory.mktemp("resuming"), frames=8, val_fraction=0.3)


@pytest.fixture(scope="module", params=list(TRAININGS))
def finished(request: pytest.FixtureRequest, coco: Path, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A training, and the folder of an uninterrupted run of it."""
    train, out = TRAININGS[request.param], tmp_path_factory.mktemp(request.param)
    train(coco, out)
    return train, out


@contextmanager
def interruption(*, epoch: int, batch: int) -> Iterator[None]:
    """Ctrl-C before a step."""
    original = Steps.on_train_batch_start

    def interrupt(self: Steps, trainer: Any, module: Any, samples: object, batch_idx: int) -> None:
        if (trainer.current_epoch, batch_idx) == (epoch, batch):
            raise KeyboardInterrupt
        original(self, trainer, module, samples, batch_idx)

    with pytest.MonkeyPatch.context() as patch, pytest.raises(SystemExit):
        patch.setattr(Steps, "on_train_batch_start", interrupt)
        yield


def weights(folder: Path, name: str = "last.ckpt") -> dict[str, torch.Tensor]:
    """The weights of a checkpoint, and those of the last step where these are an average."""
    content = torch.load(folder / name, weights_only=True)
    of_the_step = content.get("trained_state_dict", {})
    return content["state_dict"] | {f"trained.{key}": value for key, value in of_the_step.items()}


def assert_same(one: dict[str, torch.Tensor], other: dict[str, torch.Tensor]) -> None:
    assert one.keys() == other.keys()
    assert [key for key in one if not torch.equal(one[key], other[key])] == []


@pytest.mark.parametrize(
    ("finished", "epoch", "batch"),
    [
        ("detector", 0, 1), ("detector", 1, 0), ("detector", 2, 2),
        ("keypoints", 2, 2),  # its average of the weights goes on, too
        ("masks", 1, 0),  # where the body begins to learn
    ],
    indirect=["finished"],
)  # fmt: skip
def test_interrupted_run_ends_with_the_same_weights(finished, coco, tmp_path, capsys, epoch, batch):
    train, straight = finished
    with interruption(epoch=epoch, batch=batch):
        train(coco, tmp_path, resume=True)
    assert f"interrupted in epoch {epoch + 1}" in capsys.readouterr().err
    assert trained_epochs(tmp_path / "last.ckpt") == epoch
    train(coco, tmp_path, resume=True)
    assert trained_epochs(tmp_path / "last.ckpt") == 3
    for name in ("last.ckpt", "best.ckpt"):
        assert_same(weights(straight, name), weights(tmp_path, name))


def test_neither_a_pause_nor_worker_processes_change_the_weights_but_the_seed_does(finished, coco, tmp_path):
    train, straight = finished
    train(coco, tmp_path / "paused", until=1, machine=replace(ONE, workers=1))
    assert trained_epochs(tmp_path / "paused" / "last.ckpt") == 1
    # Worker processes load the first batches early: of the epoch that follows, not of the first one.
    train(coco, tmp_path / "paused", resume=True, machine=replace(ONE, workers=1))
    assert_same(weights(straight), weights(tmp_path / "paused"))
    train(coco, tmp_path / "other", seed=1, until=1)
    first, second = weights(tmp_path / "other"), weights(straight)
    assert any(not torch.equal(first[key], second[key]) for key in first)


def test_a_folder_with_a_run_is_not_written_into(finished, coco):
    train, straight = finished
    with pytest.raises(
        DataError, match="holds a run that was trained for 3 epochs.*--resume true.*--overwrite"
    ):
        train(coco, straight)
    with pytest.raises(DataError, match="choose one of them"):
        train(coco, straight, resume=True, overwrite=True)


@pytest.mark.parametrize("finished", ["detector"], indirect=True)
def test_a_folder_with_a_run_is_continued_or_started_anew(finished, coco, tmp_path, capsys):
    train, straight = finished
    (tmp_path / "notes.txt").write_text("mine")
    train(coco, tmp_path, until=1, seed=1)
    train(coco, tmp_path, overwrite=True)
    assert_same(weights(straight), weights(tmp_path))
    left = sorted(path.name for path in tmp_path.iterdir() if path.name != LOCK)
    assert left == ["best.ckpt", "last.ckpt", "logs", "notes.txt"]
    capsys.readouterr()
    train(coco, tmp_path, resume=True)
    assert "trained for 3 epochs already" in capsys.readouterr().out


@pytest.mark.parametrize("finished", ["detector", "masks"], indirect=True)
def test_more_epochs_go_on_where_the_run_ended(finished, coco, tmp_path, capsys):
    train, _ = finished
    learning = CYCLE if train is not TRAININGS["masks"] else STAGED
    train(coco, tmp_path, learning=replace(learning, epochs=1), **_heads(train))
    train(coco, tmp_path, learning=replace(learning, epochs=2), resume=True, **_heads(train))
    assert trained_epochs(tmp_path / "last.ckpt") == 2
    assert "goes on after epoch 1; learning.epochs: 1, now 2" in capsys.readouterr().out
    rows = list(csv.DictReader((tmp_path / "logs1" / "metrics.csv").read_text().splitlines()))
    rates = [float(row["rate"]) for row in rows if row["rate"]]
    expected = [learning_rate(replace(learning, epochs=2), step, 3) for step in (3, 4, 5)]
    assert rates == [pytest.approx(sum(expected) / 3)]


def _heads(train: Callable[..., Path]) -> dict[str, int]:
    return {"head_epochs": 0} if train is TRAININGS["masks"] else {}


def test_another_optimizer_or_seed_is_refused(finished, coco):
    train, straight = finished
    with pytest.raises(DataError, match="learning.optimizer .*, asked for is sgd; resume with the options"):
        train(coco, straight, learning=Learning(epochs=4, optimizer="sgd"), resume=True)
    with pytest.raises(DataError, match="seed 0, asked for is 7"):
        train(
            coco,
            straight,
            learning=replace(CYCLE, epochs=4, optimizer=_optimizer(straight)),
            seed=7,
            resume=True,
        )


def _optimizer(run: Path) -> str:
    optimizer: str = torch.load(run / "last.ckpt", weights_only=True)["run"]["learning"]["optimizer"]
    return optimizer


def test_precision_processes_labels_and_rendered_views_are_compared(tmp_path):
    run, train_json = Run(tmp_path, CYCLE, ONE), tmp_path / "train.json"
    train_json.write_text("as it was")
    (tmp_path / "studio").mkdir()
    studio = tmp_path / "studio" / "studio.json"
    studio.write_text("of the old labels")

    def settings(run: Run) -> dict[str, object]:
        return settings_of(run, train_json) | {"rendered": studio_hash(tmp_path)}

    torch.save({"epoch": 0, "run": settings(run)}, tmp_path / "last.ckpt")
    assert changes(tmp_path / "last.ckpt", settings(run)) == []
    train_json.write_text("exported anew")
    studio.write_text("of the new labels")
    other = replace(run, machine=replace(ONE, precision="bf16-mixed", devices=2))
    said = [line.split(":")[0] for line in changes(tmp_path / "last.ckpt", settings(other))]
    assert said == ["machine.precision", "machine.devices", "labels", "rendered"]


def test_checkpoints_of_version_0_1_are_compared_by_what_they_know(tmp_path):
    torch.save(
        {"settings": {"optimizer": "sgd", "rate": 0.1, "seed": 0, "model": {}}}, tmp_path / "masks.ckpt"
    )
    torch.save({"hyper_parameters": {"learning": {"rate": 0.1, "batch": 4}}}, tmp_path / "keypoints.ckpt")
    settings = {"seed": 0, "learning": {"optimizer": "sgd", "rate": 0.2, "batch": 4, "clip": 1.0}}
    for name in ("masks", "keypoints"):
        assert changes(tmp_path / f"{name}.ckpt", settings) == ["learning.rate: 0.1, now 0.2"]
    with pytest.raises(DataError, match="seed 0, asked for is 1"):
        changes(tmp_path / "masks.ckpt", {**settings, "seed": 1})


# Learning rates -----------------------------------------------------------------------------------


@pytest.mark.parametrize("optimizer", ["adam", "adamw", "rmsprop", "sgd"])
@pytest.mark.parametrize("steps", [1, 3, 10, 37])
def test_one_cycle_is_torchs(optimizer, steps):
    learning = replace(CYCLE, epochs=1, optimizer=optimizer)
    ours, torchs = (optimizer_of(torch.nn.Linear(2, 2), learning, fused=True) for _ in range(2))
    judge = torch.optim.lr_scheduler.OneCycleLR(torchs, learning.rate, total_steps=steps)
    for step in range(steps):
        set_step(ours, learning, step, steps)
        mine, wanted = ours.param_groups[0], torchs.param_groups[0]
        momentum = "betas" if "betas" in mine else "momentum"
        assert mine["lr"] == pytest.approx(wanted["lr"], rel=1e-9)
        assert mine[momentum] == pytest.approx(wanted[momentum])
        torchs.step()
        if step < steps - 1:
            judge.step()


def test_options_that_contradict_themselves():
    nan = float("nan")
    for wrong in ({"epochs": 0}, {"rate": 0.0}, {"cooldown": 2.0}, {"clip": -1.0}, {"weight_decay": nan}):
        with pytest.raises(DataError, match="learning"):
            replace(STAGED, **wrong)
    with pytest.raises(DataError, match="rises and falls by itself"):
        replace(STAGED, schedule="one_cycle")
    with pytest.raises(DataError, match="--seed"):
        Run(Path("run"), CYCLE, ONE, seed=-1)
    with pytest.raises(DataError, match="--until"):
        Run(Path("run"), CYCLE, ONE, until=0)


MISTAKES = {
    "--augment.scale=-1": "augment.scale is -1.0",
    "--machine.devices=0": "devices and threads must be at least 1",
    "--machine.workers=-1": "workers 0 or more",
    "--machine.threads=0": "threads must be at least 1",
    "--seed=4294967296": "--seed at most 4294967295",
    "--network.width_px=1": "width_px must be at least 32",
    "--network.features=33": "multiple of 32",
}


@pytest.mark.parametrize("option", MISTAKES)
def test_an_impossible_option_is_one_line(tmp_path, capsys, option):
    assert main(train_detector, [str(tmp_path), "--out", str(tmp_path / "run"), option], presets=True) == 1
    assert MISTAKES[option] in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_a_run_is_not_deleted_for_a_machine_that_is_not_there(tmp_path):
    (tmp_path / "last.ckpt").write_text("of an earlier run")
    many = Run(tmp_path, CYCLE, Machine(accelerator="gpu", devices=99), overwrite=True)
    with pytest.raises(DataError, match="asks for 99 GPUs, and torch finds"):
        start(many)
    with pytest.raises(DataError, match="cannot write .*choose another --out"):
        start(Run(tmp_path / "last.ckpt", CYCLE, ONE))
    assert (tmp_path / "last.ckpt").exists()


def test_the_best_of_a_run_without_a_last_is_not_left_to_another(tmp_path):
    """As the first epoch leaves it when it is ended between its validation and its end."""
    (tmp_path / "best.ckpt").write_text("of another run")
    with pytest.raises(DataError, match="trained for 0 epochs; go on"):
        checkpoint_to_resume(Run(tmp_path, CYCLE, ONE))
    assert checkpoint_to_resume(Run(tmp_path, CYCLE, ONE, resume=True)) is None
    delete_run(tmp_path)
    assert not (tmp_path / "best.ckpt").exists()


def test_one_training_at_a_time_writes_into_a_folder(tmp_path):
    run = Run(tmp_path, CYCLE, ONE)
    with (
        alone_in_folder(run, None),
        pytest.raises(DataError, match="another training writes into .*; wait until it ends"),
        alone_in_folder(run, None),
    ):
        pass
    with alone_in_folder(run, checkpoint_to_resume(run)):
        pass
    (tmp_path / "last.ckpt").write_text("of one that began and ended since this one looked")
    resuming = replace(run, resume=True)
    with pytest.raises(DataError, match="another training wrote a run"), alone_in_folder(resuming, None):
        pass


def test_a_foreign_file_is_no_checkpoint(tmp_path):
    for content in (b"root:x:0:0:root:/root:/bin/bash\n" * 40, b"", b"PK\x03\x04", bytes(range(256))):
        (tmp_path / "file").write_bytes(content)
        with pytest.raises(DataError, match="cannot read .* as weights"):
            read_checkpoint(tmp_path / "file")


@pytest.mark.parametrize("finished", ["detector"], indirect=True)
@pytest.mark.parametrize("lost", ["epoch", "state_dict", "optimizer_states", "loops", "run", "callbacks"])
def test_a_checkpoint_that_lost_a_part_is_one_line(finished, coco, tmp_path, lost):
    train, straight = finished
    content = torch.load(straight / "last.ckpt", weights_only=True)
    longer = Learning(**content["run"]["learning"] | {"epochs": 4})
    content[lost] = "gone"
    torch.save(content, tmp_path / "last.ckpt")
    with pytest.raises(DataError, match=r"last\.ckpt"):
        train(coco, tmp_path, resume=True, learning=longer)


def test_checkpoints_are_written_beside_their_place(tmp_path, monkeypatch):
    """Another disk may hold the temporary folder, and a copy from there can be cut off."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "not there"))
    (tmp_path / ".last.ckpt.a1b2c3d4").write_text("half")
    WholeCheckpoints().save_checkpoint({"epoch": 3}, tmp_path / "last.ckpt")
    sweep_checkpoints(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["last.ckpt"]
    assert trained_epochs(tmp_path / "last.ckpt") == 4


def test_ctrl_c_outside_of_the_training_is_one_line(capsys):
    def predict() -> None:
        """Interrupted while it is imported."""
        raise KeyboardInterrupt

    assert main(predict, []) == 130
    assert capsys.readouterr().err == "predict: interrupted; give the same command again\n"
