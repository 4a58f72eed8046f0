"""The last net of the command line, and the page's server from start to end."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

from rpl_data.cli import main as command
from rpl_data.cli.annotate import address_of
from rpl_data.cli.listening import listening
from rpl_data.workspace.workspace import Workspace


def failing(error: BaseException) -> object:
    def status(workspace: Path = Path(".")) -> None:
        """Fail."""
        raise error

    return status


def test_a_fault_of_ours_is_one_line_and_a_file(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    error = ZeroDivisionError("division by zero")
    error.add_note("segment/cup")
    monkeypatch.setitem(command.COMMANDS, "status", failing(error))
    assert command.main(["status"]) == 1
    said = capsys.readouterr().err
    path = Path(said.strip().rsplit(" ", 1)[1])
    assert said.startswith("rpl: unexpected fault in segment/cup; please report: ") and said.count("\n") == 1
    text = path.read_text()
    assert "ZeroDivisionError: division by zero" in text and "rpl status" in text and "rpl-data " in text


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (PermissionError(13, "Permission denied", "/root/x"), "rpl: cannot use /root/x: Permission denied"),
        (OSError(28, "No space left on device"), "rpl: the disk is full at status"),
        (MemoryError(), "rpl: the memory is full at status"),
    ],
)
def test_a_fault_of_the_machine_is_said_as_one(
    error: Exception, message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(command.COMMANDS, "status", failing(error))
    assert command.main(["status"]) == 1
    assert capsys.readouterr().err.startswith(message)


def test_ctrl_c_while_modules_load_is_one_line() -> None:
    """Wherever it strikes: here, when the first of our modules is looked for."""
    program = (
        "import sys, rpl_data.cli.__main__ as command\n"
        "class Impatient:\n"
        "    def find_spec(self, *_): raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Impatient())\n"
        "sys.exit(command.start())"
    )
    child = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (child.returncode, child.stderr) == (130, "rpl: interrupted before it began\n")


def test_a_port_that_is_taken_gives_way_to_the_next() -> None:
    with socket.create_server(("127.0.0.1", 0)) as first:
        port = first.getsockname()[1]
        taken, address = listening(address_of("127.0.0.1", port))
        with taken:
            assert port < address.port <= port + 20 and taken.getsockname()[1] == address.port


def test_ctrl_c_of_the_server_with_a_page_open_is_quiet(tiny_workspace: Workspace) -> None:
    program = [sys.executable, "-m", "rpl_data.cli", "annotate", str(tiny_workspace.root), "--port", "8917"]
    server = subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert server.stdout is not None and server.stderr is not None
    url = server.stdout.readline().split()[1]
    with urllib.request.urlopen(f"{url}api/news", timeout=60) as stream:
        assert b"hello" in stream.readline()
        server.send_signal(signal.SIGINT)
        _, said = server.communicate(timeout=60)
    assert said.splitlines() == ["rpl: interrupted; run the same command again and it goes on from here"]
    assert server.returncode == 130
