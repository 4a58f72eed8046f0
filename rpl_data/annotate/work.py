"""What the annotation server is handed: the stages it lets a person run, as functions.

A stage never imports another one, so solving, building and exporting arrive here as arguments.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from rpl_data.clicks.log import Annotation, GraspClicks
from rpl_data.geometry import Transform
from rpl_data.types import ClickResidual, KeypointModel, Observation, Solution

Tell = Callable[[str, int, int], None]
"""``tell(what, done, total)``: progress of a job; it may raise to stop it."""


@dataclass(frozen=True)
class Work:
    """Functions of the other stages.

    Attributes:
        solve: the sparse model and scene transforms of some clicks; DataError when they do not tie.
        register: `scene_from_object` of one scene from clicks on a known model, and their residuals.
        objects: names of the objects of the workspace, in order.
        add_object: (name, keypoint names) makes a new object of the workspace.
        grasp: `object_from_grasp` of two clicks; DataError where there is no depth or no place.
        run: (last stage, tell) runs what is out of date up to that stage; lines for a person.
        fresh: by stage, whether what it made still holds; stages that wait for others are absent.
    """

    solve: Callable[[Annotation, Sequence[Observation]], Solution]
    register: Callable[[KeypointModel, Sequence[Observation]], tuple[Transform, tuple[ClickResidual, ...]]]
    objects: Callable[[], list[str]]
    add_object: Callable[[str, Sequence[str]], None]
    grasp: Callable[[GraspClicks, Solution], Transform]
    run: Callable[[str, Tell], list[str]]
    fresh: Callable[[], Mapping[str, bool]]


@dataclass(frozen=True)
class Place:
    """Where the server listens.

    Attributes:
        token: what a browser must show; None on this machine's own address only.
    """

    host: str
    port: int
    token: str | None

    @property
    def url(self) -> str:
        """What to open in the browser."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{host}:{self.port}/" + (f"?token={self.token}" if self.token else "")
