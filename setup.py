"""What `pyproject.toml` cannot say.

The programs of `training/` are installed as `rpl_data.training`: a package called `training` would be in the
way of everybody else's. `examples/` come with them, as `rpl_data.examples`. And the README of the package has
no links into the checkout, which lead nowhere where it is shown.
"""

import re
from pathlib import Path

from setuptools import find_packages, setup

PROGRAMS = [*find_packages(include=["training", "training.*"]), "training.examples"]
PAGES = (
    "Pages named `docs/...`, and pictures, are in the source distribution; `make docs` there builds the site."
)


def packaged(readme: str) -> str:
    """The README as the package's description: pictures left out, links to files written as their paths."""
    text = re.sub(r"!\[[^]]*\]\((?!https:)[^)]*\)\n?", "", readme)
    text = re.sub(r"\[`?(docs/[^]`#]+)`?\]\((?!https:)[^)#]+[^)]*\)", r"`\1`", text)
    text = re.sub(r"\[([^]]+)\]\((?!https:|#)([^)#]+)[^)]*\)", r"\1 (`\2`)", text)
    title, rest = text.split("\n", 1)
    return f"{title}\n\n{PAGES}\n{rest}"


if __name__ == "__main__":
    setup(
        packages=[
            *find_packages(include=["rpl_data", "rpl_data.*"]),
            *(f"rpl_data.{name}" for name in PROGRAMS),
            "rpl_data.examples",
        ],
        package_dir={"rpl_data.training": "training", "rpl_data.examples": "examples"},
        long_description=packaged(Path("README.md").read_text(encoding="utf-8")),
        long_description_content_type="text/markdown",
    )
