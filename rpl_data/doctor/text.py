"""Format a diagnosis as text for a terminal."""

from __future__ import annotations

import textwrap

from rpl_data.doctor.findings import Diagnosis
from rpl_data.wording import counted


def describe(diagnosis: Diagnosis, *, width: int = 110) -> str:
    """Write a heading, the facts, and for each finding what is wrong, how sure it is, and what to do."""
    lines = textwrap.wrap(f"scene {diagnosis.scene}: {_verdict(diagnosis)}", width, subsequent_indent="    ")
    for fact in diagnosis.facts:
        lines += textwrap.wrap(fact, width, initial_indent="    ", subsequent_indent="    ")
    for finding in diagnosis.findings:
        lines += textwrap.wrap(
            f"! {finding.kind} ({finding.sureness}): {finding.what}",
            width, initial_indent="  ", subsequent_indent="      ",
        )  # fmt: skip
        lines += textwrap.wrap(
            f"what to do: {finding.todo}", width, initial_indent="      ", subsequent_indent="      "
        )
    return "\n".join(lines)


def summarize(diagnosis: Diagnosis) -> str:
    """One line: how many faults, of which kinds, and how sure each is."""
    kinds = ", ".join(f"{finding.kind} ({finding.sureness})" for finding in diagnosis.findings)
    return f"scene {diagnosis.scene}: {_verdict(diagnosis)}{': ' if kinds else ''}{kinds}"


def _verdict(diagnosis: Diagnosis) -> str:
    """What is wrong, and what could not be judged: where that is much, little speaks for the recording."""
    count = len(diagnosis.findings)
    wrong = f"{counted(count, 'thing')} wrong" if count else ""
    if not diagnosis.unjudged:
        return wrong or "nothing wrong was found"
    unjudged = f"not judged: {'; '.join(diagnosis.unjudged)}"
    return f"{wrong}; {unjudged}" if wrong else f"{unjudged}; no fault in the rest"
