"""The steps of a build as a graph: each runs once the steps before it are done, wherever there is room.

Only this process writes the ledger. A step in another process writes its files whole or not at all, so
whatever is killed, a step is either in the ledger or runs again.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field, replace

from rpl_data.pipeline.ledger import Ledger, Outcome, Step
from rpl_data.pipeline.pool import Pool
from rpl_data.pipeline.progress import Progress, Tell
from rpl_data.pipeline.worker import Done, EngineLost
from rpl_data.types import DataError

HERE = ("twin", "clicks", "cut", "export/to")
"""Stages, and a step, of this process: two take no time, a twin is rendered by processes of its own, and
workers need no access to the store that exports are copied to."""
BY_RANGES = ("label",)
"""Stages that spread the frames of one scene over the pool, where there are fewer scenes than workers."""
BY_SCENE = ("track", "drift", "surface", "label")
"""Stages whose failure concerns one scene, which can be left out of what follows."""
LISTEN_EVERY_S = 0.2


@dataclass
class Graph:
    """Runs steps, in this process or in others.

    Attributes:
        again: stages whose steps run even if they are up to date.
        keep_going: whether other steps still run after one that failed.
        failed: why steps failed, by name.
    """

    ledger: Ledger
    pool: Pool
    tell: Tell
    again: Collection[str] = ()
    keep_going: bool = False
    failed: dict[str, Exception] = field(default_factory=dict)
    _told: set[str] = field(default_factory=set)
    _running: dict[Future[Done], Step] = field(default_factory=dict)

    def run(self, steps: Sequence[Step]) -> None:
        """Bring steps up to date, in their order where it matters.

        Raises:
            Exception: a step failed, unless the others are to go on; the steps after it are not run then.
        """
        waiting = {step.name: step for step in steps}
        open_names, dropped = set(waiting), set(self.failed)
        while waiting or self._running:
            ready = self._ready(waiting, open_names, dropped)
            for number, step in enumerate(ready, start=1):
                if self._is_sent(step, len(ready) - number):
                    self.ledger.begin(step)
                    self._running[self.pool.engine.submit(step)] = step
                else:
                    self._run_here(step)
                    open_names.discard(step.name)
            self._collect(open_names)
            dropped |= self.failed.keys()

    def _ready(self, waiting: dict[str, Step], open_names: set[str], dropped: set[str]) -> list[Step]:
        """Take the steps out of `waiting` that can run now, and those that need not or cannot."""
        ready = []
        for step in list(waiting.values()):
            if not open_names.isdisjoint(step.after):
                continue
            del waiting[step.name]
            if not dropped.isdisjoint(step.after):
                dropped.add(step.name)
            elif not self._is_up_to_date(step):
                ready.append(step)
                continue
            open_names.discard(step.name)
        return ready

    def _is_up_to_date(self, step: Step) -> bool:
        is_first, anyway = step.name not in self._told, step.stage in self.again
        self._told.add(step.name)
        if not self.ledger.holds(step) or (anyway and is_first):
            return False
        if is_first:
            self.ledger.renew(step)
            entry = self.ledger.entries[step.name]
            self.tell(Progress(step.stage, step.item, "kept", seconds=entry.seconds, outcome=entry.outcome))
        return True

    def _is_sent(self, step: Step, others_ready: int) -> bool:
        """Whether a step runs in another process."""
        known = self.ledger.entries.get("import")
        if (
            step.stage in HERE
            or step.name in HERE
            or not self.pool.is_worth(known.outcome.frames if known else 0)
        ):
            return False
        beside = others_ready + len(self._running)
        if step.stage in BY_RANGES and beside + 1 < self.pool.workers:
            return False
        return bool(beside) or not self.pool.is_near

    def _run_here(self, step: Step) -> None:
        def advance(done: int, total: int) -> None:
            self.tell(Progress(step.stage, step.item, "runs", done, total))
            self._tell_reports()

        self.tell(Progress(step.stage, step.item, "runs"))
        self.ledger.begin(step)
        started = time.perf_counter()
        try:
            outcome = step.run(advance)
        except Exception as error:
            self._fail(step, error)
        else:
            self._record(step, outcome, time.perf_counter() - started)

    def _collect(self, open_names: set[str]) -> None:
        """Wait for a step in another process to end, and record it."""
        if not self._running:
            return
        finished = wait(self._running, timeout=LISTEN_EVERY_S, return_when=FIRST_COMPLETED).done
        self._tell_reports()
        for future in finished:
            step = self._running.pop(future)
            open_names.discard(step.name)
            try:
                outcome, seconds = future.result()
            except Exception as error:
                self._fail(step, error)
                continue
            self._record(step, outcome, seconds)

    def _record(self, step: Step, outcome: Outcome, seconds: float) -> None:
        """Note a step as done; where it left something out, so that the next build runs it again."""
        left_out: dict[str, str] = outcome.details.get("left_out", {})
        if left_out:
            step = replace(step, options=step.options | {"left_out": sorted(left_out)})
            self.failed |= {f"{step.stage}/{path}": DataError(why) for path, why in left_out.items()}
        self.ledger.record(step, outcome, seconds)
        self.tell(Progress(step.stage, step.item, "ran", seconds=seconds, outcome=outcome))

    def _tell_reports(self) -> None:
        at_work = {step.name: step for step in self._running.values()}
        for name, done, total in self.pool.reports():
            if name in at_work:  # what was said before a step ended may arrive afterwards
                self.tell(Progress(at_work[name].stage, at_work[name].item, "runs", done, total))

    def _fail(self, step: Step, error: Exception) -> None:
        """Note why a step failed, where the others go on."""
        explained = self.pool.explained(error, step.name)
        explained.add_note(step.name)  # for whoever reports a fault of ours
        if explained is not error:
            explained.__cause__ = error
        if not self.keep_going or isinstance(explained, EngineLost):
            raise explained
        self.failed[step.name] = explained
        self.tell(Progress(step.stage, step.item, "failed", outcome=Outcome(messages=(_why(explained),))))

    def lost_places(self) -> set[str]:
        """The scenes and recordings in which a step failed."""
        split = (name.partition("/") for name in self.failed)
        return {item for stage, _, item in split if stage in BY_SCENE}

    def refuse_objects_and_exports(self) -> None:
        """Raise the list of what failed, where more than some scenes did: there is no going on without it."""
        if any(name.partition("/")[0] not in ("import", *BY_SCENE) for name in self.failed):
            self.refuse_failed()

    def refuse_failed(self) -> None:
        """Raise a DataError that lists the steps that failed; nothing without any."""
        if self.failed:
            lines = [f"    {name.replace('/', ' ', 1)}: {_why(error)}" for name, error in self.failed.items()]
            raise DataError(
                f"{len(lines)} of the steps failed; their scenes are left out of what was made:\n"
                + "\n".join(lines)
            ) from next(iter(self.failed.values()))


def _why(error: Exception) -> str:
    return str(error) if isinstance(error, DataError) else f"unexpected fault: {error!r}"
