"""Every damage to every dialect: how many are named, raise an alarm without a name, or are missed."""

from __future__ import annotations

import time
from collections import Counter
from pathlib import Path

from export_damage import damaged, damages, names, write_all
from rows import record

from rpl_data.export.checks import CHECKS, check_export


def test_every_damage(tmp_path: Path) -> None:
    exports = write_all(tmp_path)
    for dialect in CHECKS:
        folder, found, missed = exports / dialect, Counter[str](), []
        if not folder.is_dir():
            continue
        started = time.perf_counter()
        alarms = check_export(folder, dialect)
        seconds = time.perf_counter() - started
        for damage in damages(folder):
            with damaged(folder, damage):
                said = [str(fault) for fault in check_export(folder, dialect)]
            named = any(names(damage, fault) for fault in said)
            found["named" if named else "alarm" if said else "missed"] += 1
            if not named:
                missed.append(f"    {damage.pattern}")
        named, all_damages = found["named"], sum(found.values())
        record("checks", f"{dialect}: damages named", named / all_damages, "share", more_is_better=True)
        record("checks", f"{dialect}: a check", 1000 * seconds, "ms")
        print(f"{dialect:16s} false alarms {len(alarms)}, {dict(found)}, {1000 * seconds:.0f} ms per check")
        print("\n".join(missed))
        assert not alarms
