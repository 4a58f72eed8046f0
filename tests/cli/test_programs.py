"""The training programs by way of `rpl`, with their presets by name."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from rpl_data.cli import programs
from rpl_data.cli.main import main
from rpl_data.types import DataError
from training.commands import PROGRAMS
from training.runs.presets import CONFIGS, preset_file, with_preset_files
from training.runs.program import main as run_program

ROOT = Path(__file__).parents[2]


def test_every_group_has_a_text_and_programs() -> None:
    assert set(programs.PROGRAMS) == {*PROGRAMS, "reproduce"}


@pytest.mark.parametrize(("group", "name"), [(g, name) for g, names in PROGRAMS.items() for name in names])
def test_help_of_a_program_shows_how_it_is_called(
    group: str, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        main([group, name, "--help"])
    assert end.value.code == 0
    said = " ".join(capsys.readouterr().out.split())
    assert said.startswith(f"usage: rpl {group} {name} ")
    assert f"For example: rpl {group} {name} " in said


@pytest.mark.parametrize(
    "called", [["-m", "rpl_data.cli", "train", "keypoints"], ["-m", "training.train_keypoints"]]
)
def test_help_needs_neither_torch_nor_lightning(called: list[str]) -> None:
    done = subprocess.run(
        [sys.executable, "-X", "importtime", *called, "--help"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    imported = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}
    assert "rpl_data.torch.transforms" in imported
    assert not imported & {"torch", "pytorch_lightning", "cv2"}
    assert "--learning.epochs" in done.stdout


def test_a_program_that_is_not_there_is_said_with_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["train", "keypoint"])
    assert end.value.code == 2
    assert "there is no command 'keypoint'; did you mean keypoints?" in capsys.readouterr().err


def test_a_mistake_in_a_program_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "masks", "export", "--config", "mask_cpu", "--out", str(tmp_path / "run")]) == 1
    said = capsys.readouterr().err
    assert said.startswith("rpl train masks: there is no file mask_cpu; ") and said.count("\n") == 1
    assert "masks_cpu, masks_paper" in said


def test_a_preset_is_meant_by_its_name_or_a_file_by_its_path(tmp_path: Path) -> None:
    own = tmp_path / "keypoints_cpu.yaml"
    own.write_text("seed: 3\n")
    assert preset_file("keypoints_cpu") == preset_file("keypoints_cpu.yaml") == CONFIGS / own.name
    assert preset_file(own) == own
    told = ["coco", "--config", "masks_cpu", f"--config={own}", "--seed", "1"]
    assert with_preset_files(told) == [
        "coco", "--config", str(CONFIGS / "masks_cpu.yaml"), f"--config={own}", "--seed", "1"
    ]  # fmt: skip
    with pytest.raises(DataError, match="one of the presets detector_cpu"):
        preset_file(tmp_path / "masks_cpu")


def test_without_a_checkout_the_installed_programs_run(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    assert programs.commands_module() == "training.commands"
    monkeypatch.setattr(programs, "CHECKOUT", tmp_path)
    assert programs.commands_module() == "rpl_data.training.commands"


def test_a_missing_lightning_is_said_with_its_remedy(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def train() -> None:
        """Needs what is not installed."""
        import pytorch_lightning  # noqa: F401

    monkeypatch.setitem(sys.modules, "pytorch_lightning", None)
    assert run_program(train, [], called="rpl train") == 1
    assert capsys.readouterr().err == (
        "rpl train: PyTorch Lightning is not installed; pip install 'rpl-data[training]'\n"
    )


def test_ctrl_c_in_a_training_says_how_it_goes_on(capsys: pytest.CaptureFixture[str]) -> None:
    def train(resume: bool = False) -> None:
        """Interrupted while it reads the export."""
        raise KeyboardInterrupt

    assert run_program(train, [], called="rpl train masks") == 130
    assert capsys.readouterr().err == (
        "rpl train masks: interrupted; "
        "give the same command again, with --resume true where an epoch was finished\n"
    )
