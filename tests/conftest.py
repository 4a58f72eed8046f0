"""Fixtures several test files share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


def pytest_collection_modifyitems(items: list[pytest.Item], config: pytest.Config) -> None:
    """Tests on real recordings run where RPL_REAL_DATA points at them; elsewhere they are deselected."""
    if "RPL_REAL_DATA" in os.environ:
        return
    real = [item for item in items if "real_data" in getattr(item, "fixturenames", ())]
    config.hook.pytest_deselected(items=real)
    items[:] = [item for item in items if item not in real]


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder with the real recordings: desk/, kitchen/, ycb/."""
    return Path(os.environ["RPL_REAL_DATA"])
