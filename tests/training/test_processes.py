"""Several processes that train one network together (DDP)."""

from __future__ import annotations

import json
import multiprocessing
import os
import socket
from pathlib import Path

import pytest
import torch
from labelled_scenes import exported

import rpl_data.torch.datamodule  # noqa: F401 (here, or each process would import them for itself)
import training.keypoints.module  # noqa: F401
import training.runs.trainer  # noqa: F401
from training.runs.options import Learning, Machine, Network
from training.train_keypoints import train_keypoints

PROCESSES = 2


def _train(rank: int, port: int, coco: Path, out: Path) -> None:
    """One of the processes, started as torchrun does."""
    os.environ |= {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port), "TORCHELASTIC_RUN_ID": "test"}
    os.environ |= {"WORLD_SIZE": str(PROCESSES), "RANK": str(rank), "LOCAL_RANK": str(rank)}
    train_keypoints(
        coco,
        "box",
        out,
        network=Network(stacks=1, features=16, levels=2, input_px=32, heatmap_px=8),
        learning=Learning(epochs=1, batch=1, optimizer="adam"),
        machine=Machine(accelerator="cpu", devices=PROCESSES, threads=1),
        cache=False,
        validate_every=0,
    )


def _train_together(coco: Path, out: Path) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    context = multiprocessing.get_context("fork")
    started = [context.Process(target=_train, args=(rank, port, coco, out)) for rank in range(PROCESSES)]
    for process in started:
        process.start()
    for process in started:
        process.join(60)
        process.kill()
    assert [process.exitcode for process in started] == [0] * PROCESSES


@pytest.mark.skipif(torch.cuda.is_available(), reason="processes cannot be forked beside a GPU")
def test_two_processes_train_together(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """With one image per batch, a process that cannot read its own takes the step of the other."""
    coco = exported(tmp_path, frames=8, val_fraction=0.3)
    images = json.loads((coco / "train.json").read_text())["images"]
    (coco / images[2]["file_name"]).unlink()
    _train_together(coco, tmp_path / "run")
    said = capfd.readouterr().out
    assert said.count("epoch 1/1:") == 1 and "left out 1 time" in said
    run = torch.load(tmp_path / "run" / "last.ckpt", weights_only=True)
    assert run["global_step"] == 3  # five instances, one of them twice: three for each process
    assert all(weight.isfinite().all() for weight in run["state_dict"].values())
