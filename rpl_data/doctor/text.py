"""Format a diagnosis as text for a terminal."""

from __future__ import annotations

import textwrap

from rpl_data.doctor.findings import Diagnosis


def describe(diagnosis: Diagnosis, *, width: int = 110) -> str:
    """Write a heading, the facts, and for each finding what is wrong, how sure it is, and what to do."""
    count = len(diagnosis.findings)
    things = "1 thing" if count == 1 else f"{count} things"
    verdict = f"{things} wrong" if count else "nothing wrong was found"
    lines = [f"scene {diagnosis.scene}: {verdict}"]
    for fact in diagnosis.facts:
        lines += textwrap.wrap(fact, width, initial_indent="    ", subsequent_indent="    ")
    for finding in diagnosis.findings:
        sure = f"sure {finding.sure:4.0%}" if finding.sure < 1 else "certain"
        lines += textwrap.wrap(
            f"! {finding.kind} ({sure.replace('  ', ' ')}): {finding.what}",
            width, initial_indent="  ", subsequent_indent="      ",
        )  # fmt: skip
        lines += textwrap.wrap(
            f"what to do: {finding.todo}", width, initial_indent="      ", subsequent_indent="      "
        )
    return "\n".join(lines)
