"""The functions that the annotation server receives: stages that the user can run from the page.

A stage never imports another one, so solving, building and exporting are passed in as arguments.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from rpl_data.clicks.log import Annotation, GraspClicks
from rpl_data.geometry import Transform
from rpl_data.types import ClickResidual, KeypointModel, Observation, Solution

Tell = Callable[[str, int, int], None]
"""``tell(what, done, total)`` reports the progress of a job; it may raise to stop it."""


GoOn = Callable[[], None]
"""Called again and again during long work; it may raise to end it."""
Check = Callable[[GoOn], Solution]
Solve = Callable[[Annotation, Sequence[Observation]], tuple[Solution, Check | None]]


@dataclass(frozen=True)
class Work:
    """Functions of the other stages.

    Attributes:
        solve: solves the sparse model and scene transforms from clicks; DataError when they do not tie.
            Also gives a function that makes the final solution, with the check of its clicks; None when the
            solution is final.
        register: `scene_from_object` of one scene from clicks on a known model, and their residuals.
        objects: returns the names of the workspace's objects, in order.
        add_object: (name, keypoint names) adds an object to the workspace.
        grasp: `object_from_grasp` of two clicks; DataError where there is no depth or no pose.
        run: (last stage, tell) runs what is out of date up to that stage; returns lines for the user.
        fresh: whether each stage is up to date; stages that wait for others are absent.
        find: (object, scene, tell) places a known object in a scene without clicks; returns lines for the
            user; UnsureError, with the click that would tell, where it is not sure.
        expected_px: (solution, scene) is the expected error of the keypoints over the images of a scene.
        limits_px: the expected errors above which a label is rough (its quality is below 0.5), and above
            which its frame is left out of the dataset.
    """

    solve: Solve
    register: Callable[[KeypointModel, Sequence[Observation]], tuple[Transform, tuple[ClickResidual, ...]]]
    objects: Callable[[], list[str]]
    add_object: Callable[[str, Sequence[str]], None]
    grasp: Callable[[GraspClicks, Solution], Transform]
    run: Callable[[str, Tell], list[str]]
    fresh: Callable[[], Mapping[str, bool]]
    find: Callable[[str, str, Tell], list[str]]
    expected_px: Callable[[Solution, str], float]
    limits_px: Callable[[], tuple[float, float]]


@dataclass(frozen=True)
class Address:
    """The address that the server listens at.

    Attributes:
        token: secret that a browser must send; None only on this machine's own address.
    """

    host: str
    port: int
    token: str | None

    @property
    def url(self) -> str:
        """The address to open in the browser."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{host}:{self.port}/" + (f"?token={self.token}" if self.token else "")
