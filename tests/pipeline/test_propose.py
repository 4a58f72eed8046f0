"""Networks that see poses place what has no labels, by the evidence, and are compared with what has."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import cycle
from pathlib import Path

import numpy as np
import pytest
from built_once import moved_copy

from rpl_data.geometry import Transform, from_rotvec, invert
from rpl_data.pipeline.build import alone_in
from rpl_data.pipeline.placements import without_scenes
from rpl_data.pipeline.progress import Progress, Tell
from rpl_data.pipeline.propose import Networks, compared_line, propose
from rpl_data.report import write_report
from rpl_data.symmetries import turn
from rpl_data.types import (
    ColorImage,
    DataError,
    DepthImage,
    Intrinsics,
    KeypointModel,
    SymmetryAxis,
    SymmetryRecord,
    Turns,
    UnsureError,
)
from rpl_data.workspace.workspace import Workspace

HALF_TURN = Turns(SymmetryAxis((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)), 2)


def network_by_labels(place: Workspace, scene: str, *, off_m: float = 0.0, turning: bool = False) -> Networks:
    """A network that sees the carton of a scene where its labels have it, in each image that it is shown.

    With `turning`, two images of three show it half a turn about its z axis away.
    """
    turned = cycle([np.eye(4), turn(HALF_TURN.axis, np.pi), turn(HALF_TURN.axis, np.pi)])
    solution = place.load_placed("carton")
    shown = iter(place.load_trajectory(place.load_scene(scene)).scene_from_camera)
    beside = from_rotvec(np.array([0.0, 0.0, 3 * off_m]), np.array([off_m, 0.0, 0.0]))
    rng = np.random.default_rng(0)

    def look(image: ColorImage, camera: Intrinsics, depth: DepthImage | None) -> dict[str, Transform]:
        assert image.shape[:2] == (camera.height, camera.width)
        assert depth is not None and depth.shape == image.shape[:2]
        shake = from_rotvec(0.05 * rng.normal(size=3), 0.002 * rng.normal(size=3))
        seen = invert(next(shown)) @ solution.scene_from_object[scene] @ beside @ shake
        return {"carton": seen @ next(turned) if turning else seen}

    return Networks({"carton": solution.model}, {"carton": "carton/best.ckpt"}, look)


@pytest.fixture
def place(plain_build: Path, tmp_path: Path) -> Workspace:
    return Workspace(moved_copy(plain_build, tmp_path / "copy") / "ws")


@pytest.mark.parametrize(("off_m", "symmetric"), [(0.0, True), (0.05, False)])
def test_a_network_is_compared_with_labels(place: Workspace, off_m: float, symmetric: bool) -> None:
    networks = network_by_labels(place, "01", off_m=off_m, turning=symmetric)
    if symmetric:
        points = place.load_placed("carton").model.points_object
        place.save_symmetry("carton", SymmetryRecord(points, None, 1.0, confirmed=(HALF_TURN,)))
    told: list[Progress] = []
    [said] = propose(place, networks, scenes=["01"], tell=told.append)
    assert [progress.state for progress in told] == [*["runs"] * 6, "ran"]
    found = re.fullmatch(
        r"carton in scene 01: the network puts it (\d+) mm from its labels, by (\d+) of (\d+) frames that "
        r"agree to (\d+) mm, too few to judge the labels by",
        said,
    )
    assert found is not None, said
    apart, agreeing, looked, _ = map(int, found.groups())
    assert abs(apart - 1e3 * off_m) < 12 and agreeing == looked == 6
    view = place.load_network_views("carton")["01"]
    assert len(view.off_m) == 6 and view.network == "carton/best.ckpt"
    enough = compared_line(place, "carton", "01", replace(view, off_m=(0.008,) * 8))
    assert ("look at that scene" in enough) == (off_m > 0)
    assert "Networks and labels" in write_report(place).read_text()


def take_labels_away(place: Workspace, scene: str) -> None:
    """As if the carton had never been clicked in a scene."""
    clicks = place.clicks_file("carton")
    lines = clicks.read_text().splitlines(True)
    clicks.write_text("".join(line for line in lines if f'"{scene}"' not in line))
    refined = without_scenes(place.load_placed("carton"), [scene])
    place.save_solution(without_scenes(place.load_solution("carton"), [scene]))
    place.save_refined(refined)


def test_a_scene_without_labels_is_placed_by_evidence(place: Workspace) -> None:
    networks = network_by_labels(place, "02")
    true = place.load_placed("carton").scene_from_object["02"]
    take_labels_away(place, "02")
    said = list(propose(place, networks, scenes=["02"]))
    assert "placed automatically in scene 02" in said[0], said
    assert "by the network, 6 of 6 frames agree on a pose" in said[0]
    off = invert(true) @ place.load_placed("carton").scene_from_object["02"]
    assert np.linalg.norm(off[:3, 3]) < 0.003


def test_a_step_that_placed_nothing_is_over(place: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    def unsure(*arguments: object, title: tuple[str, str], tell: Tell) -> None:
        tell(Progress(*title, "runs"))
        raise UnsureError("carton was not placed in scene 02")

    networks = replace(network_by_labels(place, "02"), look=lambda *image: {})
    take_labels_away(place, "02")
    monkeypatch.setattr("rpl_data.pipeline.propose.run_step", unsure)
    told: list[Progress] = []
    [said] = propose(place, networks, scenes=["02"], tell=told.append)
    assert said == "carton was not placed in scene 02 (by the network, 0 of 6 frames agree on a pose)"
    assert told[-2:] == [Progress("register", "carton", "runs"), Progress("register", "carton", "failed")]


def test_networks_and_scenes_of_others_are_refused(place: Workspace) -> None:
    model = place.load_placed("carton").model
    known = Networks({"carton": model}, {"carton": "carton.ckpt"}, lambda *image: {})
    with pytest.raises(DataError, match="no scene 99 in .*it has 00, 01"):
        list(propose(place, known, scenes=["00", "99"]))
    assert place.load_network_views("carton") == {}
    fewer = KeypointModel("carton", model.keypoints[1:], model.points_object[1:])
    with pytest.raises(DataError, match="carton.ckpt: the network knows carton by the keypoints"):
        list(propose(place, replace(known, models={"carton": fewer})))
    with alone_in(place), pytest.raises(DataError, match="another build is running"):
        list(propose(place, known))
    strange = Networks({"egg": model}, {"egg": "egg.ckpt"}, lambda *image: {})
    with pytest.raises(DataError, match="no object 'egg'"):
        list(propose(place, strange))
