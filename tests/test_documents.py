"""What README and CONTRIBUTING say about Python and about the tree is so."""

from __future__ import annotations

import contextlib
import importlib
import re
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import yaml
from cube_studio import cube_studio

import rpl_data
import rpl_data.torch
from rpl_data import types
from rpl_data.workspace.workspace import Workspace

ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(ROOT.glob("docs/**/*.md"))]
TEXTS = {path.name: path.read_text(encoding="utf-8") for path in DOCUMENTS}
NAMED_WITH_THEIR_MODULE = {"DialectSummary", "TwinObject"}


INSTALLED = {"rpl_data.training": "training", "rpl_data.examples": "examples"}
"""Where folders of the checkout lie in an installed package, as `setup.py` says."""


def in_checkout(name: str, *, separator: str) -> str:
    """A dotted name or a path of an installed package, as it is in the checkout."""
    for installed, here in INSTALLED.items():
        there = installed.replace(".", separator)
        if name == there or name.startswith(there + separator):
            return here + name.removeprefix(there)
    return name


def inline_code(text: str) -> list[str]:
    """What stands between single backticks, outside of code blocks."""
    return re.findall(r"`([^`\n]+)`", re.sub(r"```.*?```", "", text, flags=re.S))


def python_blocks(text: str) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", text, re.M | re.S)


def resolved(name: str) -> Any:
    """The module or attribute that a dotted name means."""
    module, _, attribute = name.rpartition(".")
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError:
        return getattr(resolved(module), attribute)


@pytest.mark.parametrize("document", TEXTS)
def test_dotted_names_are_there(document: str) -> None:
    names = re.findall(r"\b(?:rpl_data|training)(?:\.[A-Za-z_]\w*)+", TEXTS[document])
    for name in {in_checkout(name, separator=".") for name in names if not name.endswith((".py", ".md"))}:
        if name.startswith("examples."):  # which is no package here
            assert (ROOT / name.replace(".", "/")).with_suffix(".py").is_file(), name
        else:
            assert resolved(name) is not None


@pytest.mark.parametrize("document", TEXTS)
def test_tables_have_a_head(document: str) -> None:
    """A row that lost its table is shown as it is written."""
    tables = re.findall(r"(?:^\|.*(?:\n|$))+", TEXTS[document], re.M)
    assert all(re.match(r"\|.*\n\|[-: |]+\|\n", table) for table in tables), document


@pytest.mark.parametrize("document", TEXTS)
def test_classes_are_there(document: str) -> None:
    """A name in CamelCase within backticks is a class of ours, from the front doors or the nouns."""
    known = {*rpl_data.__all__, *rpl_data.torch.__all__, *dir(types)}
    words = re.findall(r"\b[A-Z][a-z]+[A-Z]\w*", " ".join(inline_code(TEXTS[document])))
    assert set(words) <= known | NAMED_WITH_THEIR_MODULE


@pytest.mark.parametrize("document", TEXTS)
def test_files_are_there(document: str) -> None:
    """A path of this repository within backticks, or after one that says the folder."""
    for code in inline_code(TEXTS[document]):
        if re.fullmatch(r"(rpl_data|training|tests|examples|datasets|docs)/[\w./]*", code):
            assert (ROOT / in_checkout(code, separator="/")).exists(), code


def test_the_readme_names_every_example() -> None:
    names = {path.name for path in ROOT.glob("examples/*.py")}
    assert names == set(re.findall(r"`(?:examples/)?(\w+\.py)`", TEXTS["README.md"]))


def test_every_room_is_in_the_tree() -> None:
    """The table's rows begin with every room and every module of the ground."""
    rooms = {f"rpl_data/{path.parent.name}/" for path in ROOT.glob("rpl_data/*/__init__.py")}
    modules = {path.name for path in ROOT.glob("rpl_data/*.py")} - {"__init__.py"}
    firsts = " ".join(re.findall(r"^\| (`[^|]*) \|", TEXTS["CONTRIBUTING.md"], re.M))
    named = {re.sub(r"(rpl_data/\w+/).*", r"\1", code) for code in inline_code(firsts)}
    assert rooms <= named
    assert modules <= {Path(code).name for code in inline_code(firsts)}


FOREIGN = ("albumentations", "kornia", "torchdata")
"""Packages that an example may need and that nothing of ours installs."""


def test_the_python_runs(tiny_workspace: Workspace, tmp_path: Path) -> None:
    """The blocks of the README and of every page, in order, on folders and an object of their names."""
    pages = [text for name, text in TEXTS.items() if name not in ("README.md", "CONTRIBUTING.md")]
    blocks = [*python_blocks(TEXTS["README.md"]), *(block for text in pages for block in python_blocks(text))]
    assert len(blocks) >= 6
    (tmp_path / "demo").symlink_to(tiny_workspace.root)
    (tmp_path / "my-recording").symlink_to(tiny_workspace.recording)
    table = (tiny_workspace.recording / "clicks.csv").read_text().replace("carton,", "cube,")
    (tmp_path / "clicks.csv").write_text(table)
    recipe = {
        "name": "mine",
        "scenes": [{"path": "."}],
        "label": {"rate": "all"},
        "refine": {"scenes": False},  # quicker, and not what is looked at
        "objects": [{"name": "cube", "keypoints": list(tiny_workspace.model("carton").keypoints)}],
    }
    recipe["objects"][0]["clicks"] = str(tmp_path / "clicks.csv")
    (tmp_path / "my.yaml").write_text(yaml.safe_dump(recipe))
    keypoints = tiny_workspace.model("carton").keypoints
    cube_studio(tmp_path / "my-workspace/export/synthetic/studio", keypoints=keypoints)
    names: dict[str, Any] = {}
    with contextlib.chdir(tmp_path):
        for block in blocks:
            needed = re.findall(rf"^(?:import|from) ({'|'.join(FOREIGN)})\b", block, re.M)
            if all(find_spec(package) is not None for package in needed):
                exec(block, names)  # noqa: S102
        assert names["labels"].camera_from_object.shape[1:] == (4, 4) and len(names["labels"]) > 0
        assert names["train"][0]["image"].shape == (3, 256, 256)
        assert set(names["target"]) >= {"boxes", "masks"}


def test_the_citation_is_the_papers() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())["preferred-citation"]
    families = [author["family-names"] for author in cited["authors"]]
    assert cited["title"] in TEXTS["README.md"].replace("\n", " ")
    assert all(name in TEXTS["README.md"] for name in families)
