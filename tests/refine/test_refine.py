"""Scenes registered on one another: right where there is evidence, as clicked where there is none."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from made_surfaces import SCENES, Made, egg_seen_from, made, moved, print_at

from rpl_data.geometry import from_rotvec, invert, transform
from rpl_data.refine.colour import texture_of
from rpl_data.refine.evidence import Verdict
from rpl_data.refine.overlap import PARTNERS, compared_pairs
from rpl_data.refine.refine import Refined, _turned_down_now, refine_scenes
from rpl_data.refine.registration import register_scenes
from rpl_data.refine.scene_surfaces import scene_surface
from rpl_data.types import PointCloud

NAMES = [str(s) for s in range(SCENES)]


def refined(case: Made) -> Refined:
    clicks = case.clicks
    return refine_scenes(case.regions, NAMES, case.start, case.points, clicks.terms, clicks.costs)


def test_scenes_come_together_where_geometry_alone_would_let_them_turn() -> None:
    case = made()
    assert case.turned_deg(case.start) > 5
    assert case.apart_mm(case.start) > 10
    found = refined(case)
    assert [verdict.accepted for verdict in found.verdicts] == [True] * SCENES
    assert case.turned_deg(found.scene_from_object) < 0.3
    assert case.apart_mm(found.scene_from_object) < 0.7


def test_without_print_the_clicks_still_hold_the_turn() -> None:
    case = made(printed=False)
    found = refined(case)
    assert case.turned_deg(found.scene_from_object) < 1.5 * case.turned_deg(case.start)


def test_the_keypoints_move_along() -> None:
    case = made()
    found = refined(case)
    poses, points = found.scene_from_object, found.points_object
    seen = np.mean([transform(invert(poses[s]), case.clicks.clicked[s]) for s in range(SCENES)], axis=0)
    np.testing.assert_allclose(points, seen, atol=2e-4)


def test_a_scene_whose_surface_is_another_thing_stays_where_its_clicks_put_it() -> None:
    case = made()
    rng = np.random.default_rng(1)
    lump = egg_seen_from(np.array([-0.5, -0.9, -0.3]), seed=2)
    other = PointCloud(
        lump.points * [1.15, 0.8, 1.0] + [0.006, 0, 0],
        lump.normals,
        rng.integers(0, 255, lump.points.shape).astype(np.uint8),
    )
    case = replace(case, regions=case.regions | {"2": moved(other, case.true_poses[2])})
    found = refined(case)
    assert [verdict.accepted for verdict in found.verdicts] == [True, True, False]
    assert "do not agree better" in found.verdicts[2].reason or "fit much worse" in found.verdicts[2].reason
    own = case.clicks.costs(found.scene_from_object, found.points_object)[2]
    assert own < 4, "held by its clicks alone, it fits them"


def test_a_scene_with_another_print_on_the_same_shape_stays_where_its_clicks_put_it() -> None:
    case = made(seed=3)
    egg = egg_seen_from(np.array([-0.5, -0.9, -0.3]), seed=53)
    colors = np.roll(print_at(egg.points + [0.3, 0.2, 0.1]), 1, axis=1)  # the same kind of waves elsewhere
    other = moved(PointCloud(egg.points, egg.normals, colors), case.true_poses[2])
    found = refined(replace(case, regions=case.regions | {"2": other}))
    assert [verdict.accepted for verdict in found.verdicts] == [True, True, False]
    assert "another print" in found.verdicts[2].reason
    assert found.verdicts[2].gain_sigmas > 1.64, "its shape alone would be believed"


def test_a_wrong_scene_takes_no_other_along_unless_there_are_many() -> None:
    for many, turned_down in {5: [0], 8: [0, 1]}.items():
        judged = [Verdict(False, gain, 0.0, "wrong") for gain in np.arange(many) - 9.0]
        pairs = list(permutations(range(many), 2))
        assert _turned_down_now(range(many), judged, np.zeros(many, bool), pairs) == turned_down
    apart = [(0, 1), (1, 0), (2, 3), (3, 2)]
    alike = np.zeros(4, bool)
    assert _turned_down_now(range(4), judged[:4], alike, apart) == [0, 2], "the worst of each group"
    another = np.array([False, True, False, False])
    assert _turned_down_now(range(4), judged[:4], another, apart) == [1], "it may have spoilt the others"


def test_the_last_scene_is_told_why_it_is_alone() -> None:
    case = made(printed=False)
    far = moved(case.regions["1"], from_rotvec(np.zeros(3), np.array([0.5, 0, 0])))
    found = refined(replace(case, regions={"0": case.regions["0"], "1": far}))
    assert not found.registered
    assert [verdict.reason.split()[0] for verdict in found.verdicts] == ["the", "every", "it"]


def test_nothing_is_registered_where_only_one_scene_has_a_surface() -> None:
    case = made()
    case = replace(case, regions={"0": case.regions["0"]})
    found = refined(case)
    assert not found.registered
    np.testing.assert_array_equal(found.scene_from_object, case.start)
    assert {verdict.reason for verdict in found.verdicts} == {
        "it shares no surface of the object with another scene"
    }


def test_each_of_many_scenes_is_compared_with_a_few_and_all_stay_tied() -> None:
    """Scenes around two discs, which share one point of their rims."""
    turns = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    rim = np.column_stack([np.cos(turns), np.sin(turns), np.zeros(60)])
    surfaces = [
        scene_surface(PointCloud(0.1 * rim[seen] + [shift, 0, 0], rim[seen]))
        for shift in (0.0, 0.24)
        for seen in [np.arange(first, first + 20) % 60 for first in range(0, 60, 5)]
    ]
    bridge = scene_surface(
        PointCloud(np.array([[0.1, 0, 0], [0.14, 0, 0]]), np.array([[1.0, 0, 0], [-1, 0, 0]]))
    )
    poses = np.tile(np.eye(4), (25, 1, 1))
    pairs = compared_pairs([*surfaces, bridge], poses)
    assert set(pairs) == {(b, a) for a, b in pairs} and len(pairs) <= 2 * PARTNERS * 25
    reached = {0}
    for _ in range(25):
        reached |= {b for a, b in pairs if a in reached}
    assert reached == set(range(25))
    assert (0, 6) not in pairs, "opposite sides of a disc have nothing in common"
    few = compared_pairs([*surfaces[:PARTNERS], None, bridge], poses[: PARTNERS + 2])
    assert len(few) == PARTNERS * (PARTNERS + 1), "few scenes are all compared"


def test_a_common_motion_of_the_world_changes_nothing() -> None:
    case = made()
    world = from_rotvec(np.array([0.4, -1.0, 0.3]), np.array([2.0, -1.0, 0.5]))
    elsewhere = replace(
        case,
        start=world @ case.start,
        true_poses=world @ case.true_poses,
        regions={name: moved(region, world) for name, region in case.regions.items()},
        clicks=replace(
            case.clicks, clicked=transform(world, case.clicks.clicked.reshape(-1, 3)).reshape(3, -1, 3)
        ),
    )
    here, there = [
        register_scenes([scene_surface(c.regions[n]) for n in NAMES], c.start, c.points, c.clicks.terms)
        for c in (case, elsewhere)
    ]
    # Another choice of asking points (cubes of space) is all that differs. What the scenes have in common,
    # the object frame, is nobody's business here.
    relative = [found.scene_from_object[1] @ invert(found.scene_from_object[0]) for found in (here, there)]
    np.testing.assert_allclose(invert(world) @ relative[1] @ world, relative[0], atol=2e-3)


def test_texture_does_not_see_exposure_and_knows_its_slope() -> None:
    across = np.arange(-0.03, 0.03, 0.0015)
    x, y = (axis.ravel() for axis in np.meshgrid(across, across))
    points = np.column_stack([x, y, np.zeros_like(x)])
    normals = np.tile([0.0, 0.0, 1.0], (len(x), 1))
    bright, dark = [
        texture_of(PointCloud(points, normals, (level * print_at(points)).astype(np.uint8)))
        for level in (1.0, 0.8)
    ]
    inside = np.abs(points[:, :2]).max(axis=1) < 0.02
    assert bright.values[inside].std() > 0.05
    assert np.median(np.abs(bright.values - dark.values)[inside]) < 0.1 * bright.values[inside].std()
    step = np.array([0.0015, 0.0, 0.0])
    along = bright.gradients[inside] @ step
    right = np.flatnonzero(inside) + 1
    assert np.corrcoef(along[:, 0], (bright.values[right] - bright.values[inside])[:, 0])[0, 1] > 0.9
    assert np.abs(bright.gradients[..., 2]).max() < 1e-6, "nothing is known along the normal"


@pytest.mark.parametrize("printed", [True, False])
def test_texture_has_channels_only_where_there_are_colours(printed: bool) -> None:
    cloud = egg_seen_from(np.array([1.0, 0, 0]), seed=0, printed=printed)
    assert texture_of(cloud).values.shape == (len(cloud.points), 3 if printed else 0)
