"""What all training programs share: a run from its start or its last checkpoint to its end."""

from __future__ import annotations

import logging
import sys
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import torch
from pytorch_lightning import Callback, LightningModule, Trainer, seed_everything
from pytorch_lightning.loggers import CSVLogger, Logger, TensorBoardLogger
from pytorch_lightning.utilities import rank_zero_only
from torch.utils.data import DataLoader, Dataset

from rpl_data.torch.epochs import Collate, training_batches, validation_batches
from rpl_data.torch.scenes import SceneSplit
from rpl_data.types import DataError
from rpl_data.wording import counted

from .averaging import WeightAverage
from .callbacks import Checkpoints, EpochLines, LastEpochValidated, Steps, refuse_idle_patience
from .checkpoint_files import WholeCheckpoints, sweep_checkpoints
from .folder import (
    BEST,
    FOREIGN,
    LAST,
    TRAINED_ON,
    alone_in_folder,
    changes,
    checkpoint_to_resume,
    delete_run,
    new_logs,
    reading_checkpoint,
    settings_of,
    trained_epochs,
)
from .network_module import RANDOM_FRAMES, UNSEEN_SCENES, NetworkModule
from .options import Machine, Run
from .program import say_left_out, use_threads
from .together import SharedStatistics
from .trained_scenes import joined, other_images, samples_before, scene_samples

say = rank_zero_only(print)
"""Print once, also where several processes train together."""


@dataclass(frozen=True)
class Lesson:
    """What is trained, on what.

    Attributes:
        train_json: the COCO file of the training split.
        module: the network and its losses.
        train: samples to train on, drawn from torch's random state.
        val: samples to validate on, of the scenes that are trained on; None where there are none.
        collate: makes a batch of samples, some of which may be `Unreadable`.
        figure: what the validation logs and of which more is better; best.ckpt has the highest.
        unseen: samples of scenes that are not trained on, to validate on; best.ckpt goes by these where
            there are any.
        rendered_json: names the scenes of views that are rendered during the training; None without.
        settings: what else a checkpoint remembers of its run, such as the augmentation.
        drop_last: leave out the last training batch of an epoch when it is smaller than the others.
        val_batch: samples per step of the validation; those of the training when None.
    """

    train_json: Path
    module: NetworkModule
    train: Dataset[Any]
    val: Dataset[Any] | None
    collate: Collate
    figure: str
    settings: Mapping[str, Any]
    unseen: Dataset[Any] | None = None
    rendered_json: Path | None = None
    drop_last: bool = False
    val_batch: int | None = None


def start(run: Run) -> Path | None:
    """Set threads and seed; the checkpoint to go on with comes back, None for a run from the beginning.

    Raises:
        DataError: the folder holds a run, and the options do not say what to do with it; or they ask for
            more GPUs than there are.
    """
    import cv2

    _check_machine(run.machine)
    resumed = checkpoint_to_resume(run)
    use_threads(run.machine.threads)
    cv2.setNumThreads(1)  # its threads would compete with torch's
    seed_everything(run.seed, workers=True, verbose=False)
    return resumed


def say_held_out(scenes: SceneSplit, count: int) -> None:
    """Name the scenes of the training split that are only validated on, with the images in them."""
    if scenes.unseen:
        say(f"held out, to choose the best by: {', '.join(scenes.unseen)} ({count} to validate on)")


def _check_machine(machine: Machine) -> None:
    """Refuse more GPUs than this machine has, before an earlier run is deleted."""
    gpus = _gpus()
    if _on_gpus(machine) and machine.devices > gpus:
        raise DataError(
            f"machine.devices asks for {counted(machine.devices, 'GPU')}, and torch finds {gpus} here; "
            "ask for fewer, or train with --machine.accelerator cpu"
        )


def _on_gpus(machine: Machine) -> bool:
    """Whether the training runs on GPUs."""
    return machine.accelerator == "gpu" or (machine.accelerator == "auto" and _gpus() > 0)


def _gpus() -> int:
    return torch.cuda.device_count() or int(torch.backends.mps.is_available())


def fit(lesson: Lesson, run: Run, *, resumed: Path | None) -> Path:
    """Train; the path of the last checkpoint comes back. One training at a time writes into a folder.

    Args:
        lesson: what is trained, on what.
        run: where and how.
        resumed: the checkpoint to go on with, as `start` found it.

    Raises:
        DataError: these options do not go with the checkpoint or the data, or a loss is not finite.
    """
    with alone_in_folder(run, resumed):
        return _fit_alone(lesson, run, resumed)


def _fit_alone(lesson: Lesson, run: Run, resumed: Path | None) -> Path:
    refuse_idle_patience(run.learning, can_validate=not (lesson.val is None and lesson.unseen is None))
    settings = {"seed": run.seed, **settings_of(run, lesson.train_json), **lesson.settings}
    before = samples_before(resumed, lesson.settings["weights"])
    now = scene_samples(lesson.train_json)
    if lesson.rendered_json is not None and lesson.rendered_json.exists():
        now = joined(now, scene_samples(lesson.rendered_json))
    last = run.out / LAST
    done = 0 if resumed is None else trained_epochs(resumed)
    if resumed is not None:
        other = [f"other images of scene {scene} than before" for scene in other_images(before, now)]
        say("; ".join([f"goes on after epoch {done}", *changes(resumed, settings), *other]))
    if done >= (run.until or run.learning.epochs):
        say(f"{last} was trained for {counted(done, 'epoch')} already; ask for more with --learning.epochs")
        return last
    rank_zero_only(sweep_checkpoints)(run.out)
    if resumed is None:
        rank_zero_only(delete_run)(run.out)
    steps = Steps(run.learning, run.seed)
    train, val = _batches(lesson, run, done)
    if not val:
        say(f"nothing is validated, so there will be {LAST} and no {BEST}")
    lesson.module.validated_on = tuple(val)
    monitor = f"{UNSEEN_SCENES if lesson.unseen is not None else RANDOM_FRAMES}_{lesson.figure}"
    settings[TRAINED_ON] = joined(before, now)
    kept = Checkpoints(run.out, monitor=monitor, settings=settings, patience=run.learning.patience)
    # The average puts the trained weights back before a checkpoint is written, so it comes first.
    average = [WeightAverage(run.learning.ema)] if run.learning.ema else []
    if run.machine.compile:
        lesson.module.compiled_part().compile()
    trainer = _trainer(run, [steps, *average, LastEpochValidated(run.learning.epochs), EpochLines(), kept])
    started = time.process_time(), time.perf_counter()
    _fit(trainer, steps, lesson.module, train, list(val.values()), resumed, last)
    cpu_s, wall_s = time.process_time() - started[0], time.perf_counter() - started[1]
    waiting = f"{steps.waiting_s / wall_s:.0%} of {wall_s:.0f} s spent waiting for images"
    say(f"{last}: {cpu_s:.0f} s of CPU time, {waiting}")
    say_left_out(lesson.module.unreadable)  # each process says its own, where several train
    return last


def _batches(lesson: Lesson, run: Run, done: int) -> tuple[DataLoader[Any], dict[str, DataLoader[Any]]]:
    """Batches to train on after `done` epochs, and those to validate on by what they hold."""
    batch, workers = run.learning.batch, run.machine.workers
    train = training_batches(
        lesson.train,
        batch=batch,
        workers=workers,
        seed=run.seed,
        collate=lesson.collate,
        drop_last=lesson.drop_last,
        epoch=done,
    )
    judges = {RANDOM_FRAMES: lesson.val, UNSEEN_SCENES: lesson.unseen} if run.validate_every else {}
    val_batch = lesson.val_batch or batch
    return train, {
        name: validation_batches(dataset, batch=val_batch, workers=workers, collate=lesson.collate)
        for name, dataset in judges.items()
        if dataset is not None
    }


def _trainer(run: Run, callbacks: list[Callback]) -> Trainer:
    """A trainer that logs to CSV files in the run's folder, and for TensorBoard where it is installed."""
    _quieten()
    machine = run.machine
    logs = new_logs(run.out)
    loggers: list[Logger] = [CSVLogger(run.out, name="", version=logs)]
    if find_spec("tensorboard") is not None:
        loggers.append(TensorBoardLogger(run.out, name="", version=logs))
    shared = [SharedStatistics(on_gpus=_on_gpus(machine))] if machine.devices > 1 else []
    return Trainer(
        max_epochs=min(run.until or run.learning.epochs, run.learning.epochs),
        accelerator=machine.accelerator,
        devices=machine.devices,
        # Frozen layers and heads without an object get no gradient, which DDP has to be told.
        strategy="auto" if machine.devices == 1 else "ddp_find_unused_parameters_true",
        use_distributed_sampler=False,  # `EpochOrder` shares the rows out itself
        precision=machine.precision,
        deterministic="warn" if machine.deterministic else False,
        gradient_clip_val=run.learning.clip or None,
        logger=loggers,
        callbacks=callbacks,
        plugins=[WholeCheckpoints(), *shared],
        enable_checkpointing=False,  # `Checkpoints` writes them
        check_val_every_n_epoch=max(run.validate_every, 1),
        num_sanity_val_steps=0,
        enable_progress_bar=False,
        enable_model_summary=False,
        log_every_n_steps=1,
    )


def _quieten() -> None:
    """Silence what Lightning says at every start; its other warnings stay."""
    logging.getLogger("pytorch_lightning").setLevel(logging.WARNING)
    for message in (
        ".*does not have many workers.*",  # cached crops want none
        ".*number of training batches.*",
        ".*exists and is not empty.*",
        ".*LeafSpec.*is deprecated.*",
        ".*callbacks used to create the checkpoint.*",  # of version 0.1
        ".*sync_dist=True.*",  # every process validates everything, and the first one's loss is shown
        ".*find_unused_parameters=True was specified.*",
        ".*validation_step. but have no .val_dataloader.*",
    ):
        warnings.filterwarnings("ignore", message=message)


def _fit(
    trainer: Trainer,
    steps: Steps,
    module: LightningModule,
    train: DataLoader[Any],
    val: list[DataLoader[Any]],
    resumed: Path | None,
    last: Path,
) -> None:
    """Lightning's fit, with a word about how to go on after Ctrl-C."""
    try:
        trainer.fit(module, train, val or None, ckpt_path=resumed, weights_only=True)
    except FOREIGN:
        if resumed is None or steps.begun:
            raise  # the training itself failed
        with reading_checkpoint(resumed, "a checkpoint to go on with"):
            raise
    except SystemExit:  # Lightning's answer to KeyboardInterrupt
        if trainer.is_global_zero:
            print(f"interrupted in epoch {trainer.current_epoch + 1}; {_way_on(last)}", file=sys.stderr)
        raise


def _way_on(last: Path) -> str:
    """How an interrupted training goes on."""
    done = trained_epochs(last)
    if not done:
        return "no epoch was finished: give the same command again"
    return f"{last} holds what {counted(done, 'epoch')} taught: go on with the same command and --resume true"
