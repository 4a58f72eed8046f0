"""Several processes that train one network together (DDP)."""

from __future__ import annotations

import json
import multiprocessing
import os
import socket
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from labelled_scenes import exported
from torch import distributed

from training.detection.module import DetectorTraining
from training.runs.options import DetectorNetwork, Learning, Machine, Network
from training.runs.together import SharedBatchNorm2d, SharedStatistics, nothing_read
from training.train_keypoints import train_keypoints

PROCESSES = 2


def _train(rank: int, port: int, coco: Path, out: Path) -> None:
    """One of the processes, started as torchrun does."""
    os.environ |= {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port), "TORCHELASTIC_RUN_ID": "test"}
    os.environ |= {"WORLD_SIZE": str(PROCESSES), "RANK": str(rank), "LOCAL_RANK": str(rank)}
    _train_box(coco, out, processes=PROCESSES, batch=1)


def _train_box(coco: Path, out: Path, *, processes: int, batch: int) -> None:
    """Three steps, with an average of the weights."""
    train_keypoints(
        coco,
        "box",
        out,
        network=Network(stacks=1, features=16, levels=2, input_px=32, heatmap_px=8),
        learning=Learning(epochs=1, batch=batch, optimizer="sgd", rate=0.01, ema=0.9),
        machine=Machine(accelerator="cpu", devices=processes, threads=1),
        cache=False,
        validate_every=0,
    )


def _train_together(coco: Path, out: Path) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    # A fork of this process would wait for threads of OpenMP that other tests have left here.
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(
        ["rpl_data.torch.datamodule", "training.keypoints.module", "training.runs.trainer"]
    )
    started = [context.Process(target=_train, args=(rank, port, coco, out)) for rank in range(PROCESSES)]
    for process in started:
        process.start()
    for process in started:
        process.join(60)
        process.kill()
    assert [process.exitcode for process in started] == [0] * PROCESSES


def _loss(run: Path) -> float:
    lines = (run / "logs" / "metrics.csv").read_text().splitlines()
    return float(dict(zip(lines[0].split(","), lines[-1].split(","), strict=True))["train_loss"])


def test_two_processes_learn_what_one_learns_with_twice_the_batch(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """With one image per batch, a process that cannot read its own takes the step of the other."""
    coco = exported(tmp_path, frames=7)
    images = json.loads((coco / "train.json").read_text())["images"]
    (coco / images[2]["file_name"]).unlink()
    _train_together(coco, tmp_path / "two")
    said = capfd.readouterr().out
    assert said.count("epoch 1/1:") == 1 and "left out 1 time" in said
    _train_box(coco, tmp_path / "one", processes=1, batch=PROCESSES)
    one, two = (torch.load(tmp_path / run / "last.ckpt", weights_only=True) for run in ("one", "two"))
    assert one["global_step"] == two["global_step"] == 3
    for weights in ("trained_state_dict", "state_dict"):  # with the statistics of batch normalisation
        torch.testing.assert_close(two[weights], one[weights], rtol=1e-3, atol=1e-5)
    assert _loss(tmp_path / "two") == pytest.approx(_loss(tmp_path / "one"), rel=1e-5)


@pytest.fixture()
def alone(tmp_path: Path) -> Iterator[None]:
    """A group of one process."""
    distributed.init_process_group("gloo", init_method=f"file://{tmp_path}/group", rank=0, world_size=1)
    yield
    distributed.destroy_process_group()


def test_a_detector_that_could_read_nothing_takes_part_backwards_too(alone: None) -> None:
    """Else the other processes would wait for its share of each normalisation's gradient."""
    network = DetectorNetwork(architecture="small_fcos", features=32, width_px=64)
    module = DetectorTraining(["background", "box"], asdict(network), asdict(Learning()))
    module.trainer = SimpleNamespace(world_size=2)  # type: ignore[assignment]
    SharedStatistics(on_gpus=False).apply(module)
    shared = [layer for layer in module.modules() if isinstance(layer, SharedBatchNorm2d)]
    loss = nothing_read(module)
    assert loss is not None
    reached, waiting = set[Any](), [loss.grad_fn]
    while waiting:
        node = waiting.pop()
        if node is not None and node not in reached:
            reached.add(node)
            waiting += [before for before, _ in node.next_functions]
    assert sum(node.name() == "_SummedBackward" for node in reached) == len(shared) > 2
    loss.backward()  # type: ignore[no-untyped-call]
    assert all((layer.running_var == 1).all() for layer in shared), "no image, no statistics"  # type: ignore[union-attr]
    assert all(not parameter.grad.any() for parameter in module.parameters() if parameter.grad is not None)


def test_shared_normalisation_of_short_numbers_is_exact(alone: None) -> None:
    """Under autocast images come as bfloat16, whose squares would be."""
    images = (30 + torch.randn(2, 3, 16, 16, generator=torch.Generator().manual_seed(0))).bfloat16()
    shared, usual = SharedBatchNorm2d(3), torch.nn.BatchNorm2d(3)
    torch.testing.assert_close(shared(images), usual(images))
    torch.testing.assert_close(shared.running_var, usual.running_var)
