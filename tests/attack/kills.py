"""Builds, servers and trainings are killed at random moments: nothing acknowledged is lost, and all go on."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
import urllib.request
from collections import Counter
from collections.abc import Callable
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import torch
from attack.children import files_in


def rpl(*arguments: str) -> list[str]:
    """The command line of `rpl`."""
    return [sys.executable, "-m", "rpl_data.cli", *arguments]


def exports(folder: Path) -> dict[str, bytes]:
    """The annotations of the export, by name."""
    return {p.name: p.read_bytes() for p in sorted((folder / "ws/export/coco").glob("*.json"))}


def litter(folder: Path) -> list[str]:
    """Files and folders with the names that are used while writing."""
    return [str(path.relative_to(folder)) for path in (folder / "ws").rglob(".*")]


def builds(base: Path, scratch: Path, kills: int, tell: Callable[[str], None]) -> Counter[str]:
    """Kill a build again and again until one ends; its export must be that of a build left alone."""
    counts: Counter[str] = Counter()
    chance, folder = random.Random(1), scratch / "killed"
    wanted = {name: content.replace(str(base).encode(), b"BASE") for name, content in exports(base).items()}
    while counts["build: killed"] < kills:
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(base, folder, ignore=shutil.ignore_patterns("ws"))
        program = rpl(
            "build", str(folder / "recipe.yaml"), "--workspace", str(folder / "ws"), "--workers", "1"
        )
        while True:
            child = subprocess.Popen(program, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
            try:
                _, said = child.communicate(
                    timeout=chance.uniform(0.5, 15) if counts["build: killed"] < kills else 300
                )
            except subprocess.TimeoutExpired:
                child.send_signal(signal.SIGKILL)
                child.communicate()
                counts["build: killed"] += 1
                continue
            break
        found = {name: c.replace(str(folder).encode(), b"BASE") for name, c in exports(folder).items()}
        kind = "traceback" if child.returncode else "same" if found == wanted else "difference"
        counts[f"build after kills: {kind}"] += 1
        if left := litter(folder):
            counts["build after kills: litter"] += 1
            tell(f"litter: {left}")
        if kind != "same":
            tell(f"{kind}: build after kills: {said.decode()[-1500:]}")
    return counts


def servers(base: Path, scratch: Path, kills: int, tell: Callable[[str], None]) -> Counter[str]:
    """Kill the annotation server while it is clicked at; every click that it acknowledged must be there."""
    from rpl_data.workspace.workspace import Workspace

    counts: Counter[str] = Counter()
    chance, folder = random.Random(2), scratch / "served"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(base, folder)
    acknowledged: dict[int, float] = {}
    for number in range(kills):
        server = subprocess.Popen(
            rpl("annotate", str(folder / "ws"), "--port", "8951"), stdout=subprocess.PIPE, text=True
        )
        assert server.stdout is not None
        url = server.stdout.readline().split()[1]
        with urllib.request.urlopen(f"{url}api/objects/carton", timeout=30) as answer:
            seen = json.load(answer)["revision"]
        until = time.monotonic() + chance.uniform(0.1, 1.5)
        click = 0
        while time.monotonic() < until:
            u_px = round(10 + (number * 7 + click) % 250 + 0.01 * click, 2)
            mark = _click(click % 3, u_px) | {"id": f"{number}-{click}"}
            try:
                seen = _posted(f"{url}api/objects/carton", {"seen": seen, "actions": [mark]})
                acknowledged[click % 3] = u_px
                counts["annotate: clicks acknowledged"] += 1
            except OSError as error:  # also a refusal: nobody else changes this workspace
                counts["annotate: click refused, lost"] += 1
                tell(f"click refused: {error}")
            click += 1
        server.kill()
        server.communicate()
        counts["annotate: killed"] += 1
        marks = Workspace(folder / "ws").load_annotation("carton").clicks
        found = {c.keypoint: c.u_px for c in marks if (c.scene, c.frame) == ("00", 0)}
        lost = [k for k, u_px in acknowledged.items() if found.get(k) != u_px]
        if lost:
            counts["annotate: clicks lost"] += len(lost)
            tell(f"lost clicks on keypoints {lost}: {acknowledged} against {found}")
    return counts


def _click(keypoint: int, u_px: float) -> dict[str, object]:
    return {"op": "click", "keypoint": keypoint, "scene": "00", "frame": 0, "u_px": u_px, "v_px": 20.0}


def _posted(url: str, body: dict[str, object]) -> int:
    """Post actions; the revision of the log that acknowledges them."""
    request = urllib.request.Request(url, json.dumps(body).encode(), {"Content-Type": "application/json"})
    with urllib.request.urlopen(request, timeout=10) as answer:
        revision: int = json.load(answer)["revision"]
    return revision


def trainings(base: Path, scratch: Path, kills: int, tell: Callable[[str], None]) -> Counter[str]:
    """Kill trainings at random moments and go on until they end, again and again.

    The weights must be those of a training left alone, bit by bit. Each child is a fork of this process, so
    that kills fall into the training, its validation and its writing, not into the loading of torch.
    """
    for module in (
        "keypoints.module",
        "detection.module",
        "runs.trainer",
        "train_keypoints",
        "train_detector",
    ):
        import_module(f"training.{module}")
    import_module("rpl_data.torch.datamodule")
    counts: Counter[str] = Counter()
    chance = random.Random(3)
    torch.set_num_threads(1)
    for name, train in TRAININGS.items():
        folder = scratch / f"trained-{name}"
        started = time.monotonic()
        assert _trained(train, base, folder / "straight", None) == 0
        lasts_s = time.monotonic() - started
        wanted, number = _weights(folder / "straight"), 0
        while counts[f"training, {name}: killed"] < kills / len(TRAININGS):
            out = folder / f"run{number}"
            number += 1
            started, before = time.monotonic(), counts[f"training, {name}: killed"]
            while _trained(train, base, out, chance.uniform(0, lasts_s)) == -signal.SIGKILL:
                counts[f"training, {name}: killed"] += 1
            if before == counts[f"training, {name}: killed"]:  # too late: this machine has become faster
                lasts_s = min(lasts_s, time.monotonic() - started)
            same = _same(wanted, _weights(out))
            counts[f"training, {name}, after kills: {'same' if same else 'difference'}"] += 1
            if not same:
                tell(f"difference: {name} {number}")
            if left := [str(p) for p in out.rglob("*") if p.name.startswith((".", "tmp"))]:
                counts[f"training, {name}, after kills: litter"] += 1
                tell(f"litter: {left}")
    return counts


def _keypoints(coco: Path, out: Path) -> None:
    from training.runs.options import Learning, Machine, Network
    from training.train_keypoints import train_keypoints

    network = Network(stacks=1, features=16, levels=2, input_px=32, heatmap_px=8, loss="entropy")
    learning = Learning(epochs=4, batch=4, optimizer="adam", rate=2e-3, schedule="one_cycle")
    train_keypoints(coco, "carton", out, network, learning, machine=Machine("cpu", threads=1), resume=True)


def _detector(coco: Path, out: Path) -> None:
    from training.runs.options import DetectorNetwork, Learning, Machine
    from training.train_detector import train_detector

    network = DetectorNetwork(width_px=64, features=32)
    learning = Learning(epochs=4, batch=4, optimizer="sgd", rate=1e-3, schedule="one_cycle")
    train_detector(coco, out, network, learning, machine=Machine("cpu", threads=1), resume=True)


TRAININGS = {"keypoints": _keypoints, "detector": _detector}


def _trained(train: Callable[[Path, Path], None], base: Path, out: Path, killed_after_s: float | None) -> int:
    """Train in a fork of this process, which may be killed; its exit code, negative for a signal."""
    child = get_context("fork").Process(target=_train, args=(train, base / "ws/export/coco", out))
    child.start()
    child.join(killed_after_s)
    if child.exitcode is None:
        child.kill()
    child.join()
    assert child.exitcode in (0, -signal.SIGKILL), f"a training ended with {child.exitcode}"
    return child.exitcode or 0


def _train(train: Callable[[Path, Path], None], coco: Path, out: Path) -> None:
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    train(coco, out)


def _weights(run: Path) -> dict[str, Any]:
    """Of the best and the last checkpoint."""
    return {
        f"{name} {key}": value
        for name in ("best", "last")
        for key, value in torch.load(run / f"{name}.ckpt", weights_only=True)["state_dict"].items()
    }


def _same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Bit by bit."""
    return one.keys() == other.keys() and all(torch.equal(value, other[key]) for key, value in one.items())


__all__ = ["builds", "exports", "files_in", "litter", "servers"]
