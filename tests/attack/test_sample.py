"""A small sample of `make attack`, in every run of the tests."""

from __future__ import annotations

import shutil
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from attack import parsers, server
from attack.__main__ import FAULTS
from attack.children import ended

from rpl_data.workspace.workspace import Workspace


def faults(counts: Counter[str]) -> dict[str, int]:
    return {name: count for name, count in counts.items() if name.rsplit(" ", 1)[-1] in FAULTS}


def test_parsers_answer_or_refuse(tmp_path: Path) -> None:
    said: list[str] = []
    counts = parsers.attack(tmp_path, 35, said.append)
    assert not faults(counts), said
    assert sum(counts.values()) > 525


def test_the_server_answers_what_no_page_asks(tiny_workspace: Workspace, tmp_path: Path) -> None:
    shutil.copytree(tiny_workspace.root, tmp_path / "ws")
    said: list[str] = []
    with ThreadPoolExecutor(1) as own:  # after tests of the page, an event loop runs in this thread
        counts = own.submit(server.attack, tmp_path / "ws", 150, 50, said.append).result()
    assert not faults(counts), said
    assert counts["annotation server: 4xx"] > 100


@pytest.mark.parametrize(
    ("code", "kind"),
    [
        ("1 / 0", "traceback"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "signal"),
        ("while True: pass", "hang"),
        ("bytes(10**12)", "traceback"),
    ],
)
def test_the_judge_sees_a_fault(code: str, kind: str) -> None:
    def work() -> str:
        exec(code)
        return "same"

    assert ended(work, limit_s=1 if kind == "hang" else 30).kind == kind
