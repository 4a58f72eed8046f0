"""The version of the installed package."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version


def installed_version() -> str:
    """Read it from the package's metadata; "unknown" in a checkout that was never installed."""
    try:
        return version("rpl-data")
    except PackageNotFoundError:
        return "unknown"
