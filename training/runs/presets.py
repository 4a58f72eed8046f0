"""Presets by their names, so that no path into a checkout is needed: `--config keypoints_cpu`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rpl_data.types import DataError

CONFIGS = Path(__file__).parents[1] / "configs"


def preset_file(value: str | Path) -> Path:
    """The YAML file that a path or the name of a preset means.

    Raises:
        DataError: there is neither such a file nor such a preset.
    """
    path = Path(value)
    if path.is_file():
        return path
    shipped = CONFIGS / f"{path.name.removesuffix('.yaml')}.yaml"
    if path.parent == Path() and shipped.is_file():
        return shipped
    names = ", ".join(sorted(each.stem for each in CONFIGS.glob("*.yaml")))
    raise DataError(f"there is no file {value}; name a YAML file with options, or one of the presets {names}")


def with_preset_files(arguments: Sequence[str]) -> list[str]:
    """Command line arguments with paths in place of the names of presets after `--config`."""
    found: list[str] = []
    for argument in arguments:
        if found and found[-1] == "--config":
            found.append(_file_of(argument))
        elif argument.startswith("--config="):
            found.append(f"--config={_file_of(argument.removeprefix('--config='))}")
        else:
            found.append(argument)
    return found


def _file_of(value: str) -> str:
    return value if ":" in value else str(preset_file(value))  # YAML itself may be given instead of a file
