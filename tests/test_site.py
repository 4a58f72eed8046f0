"""The documentation site: complete beside the code, and it builds without a warning."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import get_args

import pytest

from rpl_data.cli.main import COMMANDS
from rpl_data.cli.programs import PROGRAMS
from rpl_data.doctor.findings import Kind
from rpl_data.pipeline.build import STAGES
from rpl_data.pipeline.stages.export import EXPORTS
from rpl_data.recordings.open import READERS, UNPACKERS

ROOT = Path(__file__).parents[1]
PAGES = {path.stem: path.read_text(encoding="utf-8") for path in ROOT.glob("docs/*.md")}


@pytest.fixture(scope="module")
def generated() -> ModuleType:
    """docs/generated.py, which mkdocs runs."""
    spec = importlib.util.spec_from_file_location("generated", ROOT / "docs/generated.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_option_of_every_command_is_documented(generated: ModuleType) -> None:
    page = generated.commands_page()
    sections = dict(zip(*[iter(re.split(r"^## (.*)$", page, flags=re.M)[1:])] * 2, strict=True))
    for words, parser in generated.parsers():
        for action in filter(generated.is_shown, parser._actions):
            assert generated.named(action) in sections[words], (words, action.dest)
            assert action.help, f"{words} {action.dest} has no help"


def test_every_command_has_a_section(generated: ModuleType) -> None:
    page = generated.commands_page()
    names = [name for name in [*COMMANDS, *PROGRAMS] if name != "_help"]
    assert all(f"\n## rpl {name}" in page for name in names)


def test_every_export_has_a_section(generated: ModuleType) -> None:
    page = generated.dialects_page()
    assert all(f"\n## {name}\n" in page for name in EXPORTS)
    assert all(f"| `{name}` |" in PAGES["exports"] for name in EXPORTS)


def test_every_reader_has_a_row() -> None:
    missing = [
        name
        for name in READERS | UNPACKERS
        if f"`{name}`" not in re.sub(r"format: (\w+)", r"`\1`", PAGES["recordings"])
    ]
    assert missing == []


def test_stage_table_is_the_build() -> None:
    assert re.findall(r"^\| `(\w+)` \|", PAGES["workspace"], re.M) == list(STAGES)


def test_every_kind_of_finding_is_explained() -> None:
    assert all(f"`{kind}`" in PAGES["troubleshooting"] for kind in get_args(Kind))


def test_every_page_is_in_the_menu() -> None:
    menu = re.findall(r": (\w+)\.md$", (ROOT / "mkdocs.yml").read_text(), re.M)
    assert sorted(menu) == sorted([*PAGES, "commands", "dialects"])


def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "mkdocs",
            "build",
            "--strict",
            "--quiet",
            "--site-dir",
            str(tmp_path / "site"),
        ],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1", "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "site/commands.html").is_file()
