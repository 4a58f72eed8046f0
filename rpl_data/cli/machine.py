"""`rpl demo` and `rpl doctor`: what works on this machine before there is a recording."""

from __future__ import annotations

from pathlib import Path


def demo(workspace: Path = Path("demo"), workers: int | None = None) -> None:
    """Build the demo: two objects in four synthetic scenes, with the errors against the exact truth.

    It takes minutes, most of them for rendering; run it again and it goes on, or says that all is up to date.

    Example: rpl demo --workspace demo

    Args:
        workspace: folder for everything that is made.
        workers: number of processes; as many as there are cores when left out, 1 = only this one.
    """
    from rpl_data.cli.building import run_build
    from rpl_data.pipeline.demo import DEMO

    run_build(DEMO, workspace, None, None, workers)


def doctor() -> None:
    """Say what is installed on this machine, what is missing, and how to get it.

    Recordings are examined by `rpl check`.

    Example: rpl doctor
    """
    from rpl_data.cli.installed import machine_lines, package_lines

    print("\n".join([*machine_lines(), "", *package_lines()]))
