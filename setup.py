"""What `pyproject.toml` cannot say: the programs of `training/` are installed as `rpl_data.training`.

A package called `training` would be in the way of everybody else's.
"""

from setuptools import find_packages, setup

PROGRAMS = find_packages(include=["training", "training.*"])

setup(
    packages=[
        *find_packages(include=["rpl_data", "rpl_data.*"]),
        *(f"rpl_data.{name}" for name in PROGRAMS),
    ],
    package_dir={"rpl_data.training": "training"},
)
