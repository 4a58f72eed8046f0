"""Symmetries with known answers: the twin's objects with their print and without it, on noisy surfaces."""

from __future__ import annotations

import numpy as np
import pytest

from rpl_data.symmetries import symmetries_of
from rpl_data.symmetry import find, find_symmetry
from rpl_data.symmetry.candidates import refined_axis
from rpl_data.symmetry.evidence import Matcher
from rpl_data.symmetry.samples import drawn_samples, part_of
from rpl_data.twin.objects import build
from rpl_data.types import Mesh, PointCloud, SymmetryAxis, Turns


@pytest.fixture(autouse=True)
def _fewer_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """A third of the samples gives the same answers in a third of the time."""
    monkeypatch.setattr(find, "PROBE_SAMPLES", 1_000)
    monkeypatch.setattr(find, "TARGET_SAMPLES", 7_000)


def noisy(name: str, *, plain: bool, sigma_m: float = 0.0003) -> Mesh:
    mesh = build(name).surface.mesh
    moved = mesh.vertices + np.random.default_rng(0).normal(0, sigma_m, mesh.vertices.shape)
    colors = np.full_like(mesh.colors, 150) if plain else mesh.colors
    return Mesh(moved, mesh.triangles, colors)


def answers(mesh: Mesh) -> list[tuple[int, int | None, int | None]]:
    """The coordinate axis that each found axis lies along, its turns, and those of the shape alone."""
    found, _ = find_symmetry(mesh)
    along = [np.abs(one.axis.direction) for one in found]
    assert all(direction.max() > np.cos(np.radians(1)) for direction in along)
    return sorted(
        (int(direction.argmax()), one.turns, one.shape_turns)
        for direction, one in zip(along, found, strict=True)
    )


def test_a_plain_carton_has_three_half_turns_and_a_printed_one_none():
    assert answers(noisy("carton", plain=True)) == [(0, 2, 2), (1, 2, 2), (2, 2, 2)]
    assert answers(noisy("carton", plain=False)) == [(0, 1, 2), (1, 1, 2), (2, 1, 2)]


@pytest.mark.parametrize(("plain", "turns"), [(True, None), (False, 1)])
def test_a_bottle_turns_freely_until_it_has_a_label(plain, turns):
    assert answers(noisy("bottle", plain=plain)) == [(2, turns, None)]


def prism(sides: int, *, radius_m: float, height_m: float) -> Mesh:
    """A plain prism; with four sides and a height of sqrt(2) radii a cube."""
    angles = 2 * np.pi * np.arange(sides) / sides
    ring = radius_m * np.column_stack([np.cos(angles), np.sin(angles)])
    low, high = (np.column_stack([ring, np.full(sides, z)]) for z in (0.0, height_m))
    middles = np.array([[0, 0, 0], [0, 0, height_m]], dtype=float)
    vertices = np.concatenate([low, high, middles])
    after, k = (np.arange(sides) + 1) % sides, np.arange(sides)
    faces = [(k, after, k + sides), (after, after + sides, k + sides)]
    faces += [
        (after, k, np.full(sides, 2 * sides)),
        (k + sides, after + sides, np.full(sides, 2 * sides + 1)),
    ]
    triangles = np.concatenate([np.column_stack(face) for face in faces])
    return Mesh(vertices, triangles, np.full((len(vertices), 3), 150, np.uint8))


@pytest.mark.parametrize(
    ("sides", "radius_m", "height_m", "turns", "rotations"),
    [
        (4, 0.05, 0.05 * np.sqrt(2), [2] * 6 + [3] * 4 + [4] * 3, 24),
        (6, 0.05, 0.12, [2] * 6 + [6], 12),
    ],
)
def test_a_cube_and_a_hexagonal_prism_have_all_their_axes(sides, radius_m, height_m, turns, rotations):
    found, _ = find_symmetry(prism(sides, radius_m=radius_m, height_m=height_m))
    assert sorted(one.turns for one in found) == turns
    every = symmetries_of([Turns(one.axis, one.turns) for one in found])
    assert len(every.discrete) == rotations - 1  # the identity is not listed


def test_a_handle_ends_all_symmetry():
    assert answers(noisy("cup", plain=True)) == []


def test_a_side_that_no_camera_saw_is_no_evidence_and_no_colour_is_not_sure():
    mesh = noisy("bottle", plain=True)
    mesh = Mesh(mesh.vertices, mesh.triangles)
    front = mesh.vertices[mesh.vertices[:, 1] > 0.01]
    found, seen = find_symmetry(mesh, PointCloud(front, np.zeros_like(front)))
    assert 0.2 < seen < 0.5
    assert all(one.compared < 0.5 and np.isnan(one.print_off) and not one.sure for one in found)


def test_an_axis_moves_to_where_the_surface_fits_itself():
    drawn = drawn_samples(build("carton").surface.mesh, None, count=6000, seed=0)
    matcher = Matcher.of(part_of(drawn, slice(1000, None)), part_of(drawn, slice(1000)))
    centre = drawn.points.mean(axis=0)
    tilted = SymmetryAxis((0.05, 0.0, float(np.sqrt(1 - 0.05**2))), (centre[0] + 0.003, centre[1], 0.0))
    refined = refined_axis(matcher, tilted, [np.pi])
    assert abs(refined.direction[2]) > np.cos(np.radians(0.02))
    box = build("carton").surface.mesh.vertices
    middle = (box.min(axis=0) + box.max(axis=0)) / 2
    np.testing.assert_allclose(refined.point_m[:2], middle[:2], atol=2e-5)
