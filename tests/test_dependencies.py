"""docs/dependencies.md names every package that the project asks for, and versions that are pinned."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
DOCUMENT = (ROOT / "docs/dependencies.md").read_text(encoding="utf-8")
PINNED = dict(line.split("==") for line in (ROOT / "constraints.txt").read_text().split() if "==" in line)


def test_every_dependency_is_listed_with_its_licence():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    asked = [*project["dependencies"], *sum(project["optional-dependencies"].values(), [])]
    names = [re.match(r"[\w-]+", each)[0] for each in asked]
    listed = re.findall(r"^\| ([\w-]+) \| [^|]+ \| [^|]+ \|$", DOCUMENT, re.MULTILINE)
    assert listed[1:] == names  # after the heading


def test_the_advisories_are_checked_against_what_is_pinned():
    rows = re.findall(r"^\| CVE[^|]+ \| ([\w-]+) \| [^|]+ \| ([\d.]+) \|$", DOCUMENT, re.MULTILINE)
    assert len(rows) == 7
    assert [(name, version) for name, version in rows if PINNED[name] != version] == []
