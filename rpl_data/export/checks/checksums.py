"""Check that the files of an export are those that were exported, by the checksums in it."""

from __future__ import annotations

from rpl_data.export.checks.findings import Findings
from rpl_data.export.checksums import NAME, read_checksums
from rpl_data.files import file_hash
from rpl_data.types import DataError


def check_checksums(findings: Findings) -> None:
    """Name the files that are others than were exported; of an export without checksums, nothing is said.

    A file that another check found missing is not named again.
    """
    try:
        sums = read_checksums(findings.folder)
    except DataError as error:
        findings.add(NAME, "", "", str(error).removeprefix(f"{NAME} is "))
        return
    named = {fault.file for fault in findings.faults}
    for file, digest in sums.items():
        path = findings.folder / file
        if not path.is_file():
            if file not in named:
                findings.add(file, "", "", f"missing, though {NAME} lists it")
        elif file_hash(path) != digest:
            findings.add(
                file, "", "", f"changed since it was exported, as {NAME} tells; that may be on purpose"
            )
