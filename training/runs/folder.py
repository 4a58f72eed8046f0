"""One rule for the folder of a run: a run in it is continued, started anew, or left alone."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, fields
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, TypeVar

import torch
from pytorch_lightning import LightningModule

from rpl_data.files import file_hash, locked
from rpl_data.types import DataError
from rpl_data.wording import counted

from .options import Learning, Run

Module = TypeVar("Module", bound=LightningModule)

LAST, BEST = "last.ckpt", "best.ckpt"
LOCK = ".training.lock"
"""A file that a training holds while it writes into the folder of its run."""

HELD_OUT = "held_out_scenes"
"""The setting that names the scenes of the training split that are only validated on."""
TRAINED_ON = "trained_on"
"""The setting by which the scenes of the training split are known again (`trained_scenes`)."""

FOREIGN = (
    UnpicklingError,
    RuntimeError,
    EOFError,
    LookupError,
    TypeError,
    ValueError,
    AttributeError,
    OSError,
)
"""What torch and Lightning raise where a file is not one that they wrote, or not whole."""

LOGS = re.compile(r"logs\d*|csv|tensorboard")
"""Folders that runs write their logs into. Mask R-CNN runs of version 0.1 wrote csv and tensorboard."""


def checkpoint_to_resume(run: Run) -> Path | None:
    """The last checkpoint where the run goes on with an earlier one, None where it starts at the beginning.

    A run that was interrupted before its first checkpoint has nothing to go on with, and starts again.

    Raises:
        DataError: the folder holds a run, and neither `resume` nor `overwrite` says what to do with it; or
            there can be no such folder.
    """
    last = run.out / LAST
    _make_folder(run.out)
    if not holds_run(run.out) or run.overwrite:
        return None
    if not run.resume:
        done = counted(trained_epochs(last), "epoch")
        raise DataError(
            f"{run.out} holds a run that was trained for {done}; go on with --resume true, start anew with "
            "--overwrite true, or choose another --out"
        )
    return last if last.exists() else None


@contextmanager
def alone_in_folder(run: Run, resumed: Path | None) -> Iterator[None]:
    """Hold the lock of a run's folder; the processes that train one network together hold it by their first.

    Raises:
        DataError: another training holds it, or wrote a run since `checkpoint_to_resume` gave `resumed`.
    """
    if not _first_process():
        yield
        return
    busy = f"another training writes into {run.out}; wait until it ends, or choose another --out"
    with locked(run.out / LOCK, busy):
        if checkpoint_to_resume(run) != resumed:
            raise DataError(f"another training wrote a run into {run.out} meanwhile; choose another --out")
        yield


def _first_process() -> bool:
    """Whether this is the only process of a training, or the first, as launchers say it."""
    told = (os.environ[name] for name in ("RANK", "LOCAL_RANK", "SLURM_PROCID") if name in os.environ)
    return int(next(told, 0)) == 0


def holds_run(out: Path) -> bool:
    """Whether a training wrote checkpoints here; one ended within its first epoch may have its best alone."""
    return (out / LAST).exists() or (out / BEST).exists()


def _make_folder(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"cannot write {out}: {error.strerror}; choose another --out") from error


def delete_run(out: Path) -> None:
    """Delete the checkpoints and logs of the run in a folder; other files stay."""
    if not holds_run(out):
        return
    for path in sorted(out.iterdir()):
        if path.is_dir() and LOGS.fullmatch(path.name):
            shutil.rmtree(path)
    for name in (BEST, LAST):  # the last one marks the run, so an interrupted deletion can be repeated
        (out / name).unlink(missing_ok=True)


def new_logs(out: Path) -> str:
    """A name for a folder of logs that is not there yet: a resumed run keeps the logs of before."""
    number = len(list(out.glob("logs*")))
    return f"logs{number}" if number else "logs"


@contextmanager
def reading_checkpoint(path: Path, expected: str) -> Iterator[None]:
    """Turn any fault in the content of a checkpoint into a DataError that names the file."""
    try:
        yield
    except DataError:
        raise
    except FOREIGN as error:
        # What torch says of others is pages about pickle; a text makes it look for a number.
        lacks_a_part = isinstance(error, KeyError) and isinstance(error.args[0], str)
        why = f"it lacks {error}" if lacks_a_part else "it is damaged, or something else wrote it"
        raise DataError(
            f"cannot read {path} as {expected}: {why}; give another one, or train again"
        ) from error


def read_checkpoint(path: Path) -> dict[str, Any]:
    """What `torch.save` wrote to a file, tensors and plain values only.

    Raises:
        DataError: the file is missing or holds anything else.
    """
    if not path.is_file():
        raise DataError(f"{path} does not exist; expected a checkpoint or a file of weights")
    with reading_checkpoint(path, "weights"):
        content = torch.load(path, map_location="cpu", weights_only=True)
    if not isinstance(content, dict):
        raise DataError(f"{path} holds a {type(content).__name__}; expected a dictionary of tensors")
    return content


def trained_epochs(checkpoint: Path) -> int:
    """How many epochs a checkpoint was trained for; 0 where there is none."""
    if not checkpoint.exists():
        return 0
    with reading_checkpoint(checkpoint, "a checkpoint of a training"):
        return int(read_checkpoint(checkpoint)["epoch"]) + 1


def settings_of(run: Run, train_json: Path) -> dict[str, Any]:
    """What decides what a run learns, beside its network: compared when the run goes on."""
    machine = {name: getattr(run.machine, name) for name in ("precision", "devices")}
    return {"learning": asdict(run.learning), "machine": machine, "labels": file_hash(train_json)[:12]}


def changes(checkpoint: Path, settings: Mapping[str, Any]) -> list[str]:
    """What differs between the settings of a checkpoint and those asked for: "rate: 0.001, now 0.0005".

    Checkpoints of version 0.1 know only some of their settings; the others are not compared.

    Raises:
        DataError: the optimizer or the seed differs, without which no run can be continued, or the scenes
            that are held out, of which the network would then have seen some.
    """
    with reading_checkpoint(checkpoint, "a checkpoint of a training"):
        before = {HELD_OUT: []} | _flat(_recorded(read_checkpoint(checkpoint)))
    now = _flat(settings)
    changed = {key: value for key, value in before.items() if key in now and now[key] != value}
    for key in ("learning.optimizer", "seed", HELD_OUT):
        if key in changed:
            raise DataError(
                f"{checkpoint} was trained with {key} {changed[key]}, asked for is {now[key]}; resume with "
                "the options it was started with, or train into another folder"
            )
    return [f"{key}: {value}, now {now[key]}" for key, value in changed.items()]


def check_same_network(checkpoint: Path, found: object, wanted: object) -> None:
    """Refuse to go on with a checkpoint of another network.

    Raises:
        DataError: `found`, of the checkpoint, is not `wanted`.
    """
    if found != wanted:
        raise DataError(
            f"{checkpoint} is of a network {found}, asked for is {wanted}; resume with the options it was "
            "started with, or train into another folder"
        )


def _recorded(content: Mapping[str, Any]) -> Mapping[str, Any]:
    """The settings in a checkpoint; those of version 0.1 lie in other places."""
    if "run" in content:
        recorded: Mapping[str, Any] = content["run"]
        return recorded
    old = content.get("settings") or content.get("hyper_parameters", {}).get("learning", {})
    names = {field.name for field in fields(Learning)}
    learning = {key: value for key, value in old.items() if key in names}
    return {"learning": learning} | ({"seed": old["seed"]} if "seed" in old else {})


def _flat(settings: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested settings with dotted names."""
    flat: dict[str, Any] = {}
    for key, value in settings.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{prefix}{key}.")
        else:
            flat[prefix + key] = value
    return flat


def load_module(kind: type[Module], checkpoint: Path, program: str) -> Module:
    """The trained network of a checkpoint, ready to predict.

    Raises:
        DataError: the checkpoint is missing, or another program wrote it.
    """
    if not checkpoint.exists():
        last = checkpoint.with_name(LAST)
        so_far = f"the run has {last} so far; best.ckpt comes with its first validation"
        hint = so_far if last.exists() else f"train one with {program}"
        raise DataError(f"there is no checkpoint {checkpoint}; {hint}")
    with reading_checkpoint(checkpoint, f"a checkpoint of {program}"):
        loaded = kind.load_from_checkpoint(checkpoint, map_location="cpu", weights_only=True)
    return loaded.eval()
