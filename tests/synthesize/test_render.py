"""Rendered pixels, colours taken from images, light, noise and shadows, by numbers known beforehand."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from cube_studio import CAMERA, COLORS, FLAT, HALF_M, UP, cube_body

from rpl_data.geometry import from_rotvec, rigid
from rpl_data.raycast import PixelTable
from rpl_data.synthesize.compose import depth_over, laid_over, shadowed
from rpl_data.synthesize.light import (
    TERMS,
    Light,
    SceneLight,
    draw_lights,
    harmonics,
    shade,
)
from rpl_data.synthesize.measure import color_noise, depth_errors, depth_noise
from rpl_data.synthesize.normals import steady_normals
from rpl_data.synthesize.paint import Photo, paint
from rpl_data.synthesize.painted import grid, texel_positions
from rpl_data.synthesize.render import Placed, alone, draw, finer_table
from rpl_data.synthesize.studio import DepthNoise, Noise, Plane
from rpl_data.types import Mesh

TABLE, FINER = PixelTable.of(CAMERA), finer_table(CAMERA)
FACING = rigid(np.diag([1.0, -1, -1]), np.array([0.0, 0.0, 0.5]))
"""Shows the face towards z, 0.45 m away: 2 x 50 mm are 33.33 px."""
SIDE_PX = 2 * HALF_M * 150 / 0.45


def even_light() -> Light:
    """A light that leaves colours as they are."""
    coefficients = np.zeros((TERMS, 3))
    coefficients[0] = 1
    return Light(np.eye(3), coefficients)


EVEN = {"cube": even_light()}
QUIET = Noise(0.0, {})


def test_a_face_has_its_colour_its_size_and_soft_edges() -> None:
    drawing = draw(FINER, [Placed(cube_body(), FACING)], EVEN)
    np.testing.assert_allclose(drawing.color[60, 80], COLORS[5], atol=0.5)
    assert drawing.alpha.sum() == pytest.approx(SIDE_PX**2, rel=0.04)
    assert {0.0, 0.25, 0.5, 0.75, 1.0} >= set(np.unique(drawing.alpha).tolist())
    found = alone(TABLE, Placed(cube_body(unseen=(5,)), FACING))
    assert found.unseen == 1.0 and found.depth_m[found.mask] == pytest.approx(0.45)


def test_the_nearer_object_hides_the_farther_one() -> None:
    nearer = FACING.copy()
    nearer[:3, 3] = [0.05, 0, 0.3]
    body = cube_body()
    for order in (1, -1):
        objects = [
            Placed(body, FACING),
            Placed(body, nearer @ from_rotvec(np.array([np.pi, 0, 0]), np.zeros(3))),
        ]
        drawing = draw(FINER, objects[::order], EVEN)
        np.testing.assert_allclose(drawing.color[60, 90], COLORS[4], atol=0.5)  # its other side, nearer
        np.testing.assert_allclose(drawing.color[60, 68], COLORS[5], atol=0.5)


def test_texels_are_found_where_they_lie() -> None:
    painted = cube_body().painted
    positions = texel_positions(painted.mesh, 2)
    triangle = np.repeat(np.arange(3), len(grid(2)))
    uv = np.tile(grid(2), (3, 1)).astype(np.float32)
    assert painted.texel_at(triangle, uv).tolist() == list(range(3 * len(grid(2))))
    np.testing.assert_allclose(
        positions[:6].mean(axis=0), painted.vertices[painted.triangles[0]].mean(axis=0)
    )


def test_colours_and_lights_of_scenes_are_told_apart() -> None:
    body = cube_body()
    lamps = {"00": np.array([0.25, 0, 0.25]), "01": np.array([-0.25, 0.2, 0])}
    photos = []
    for scene, lamp in lamps.items():
        coefficients = FLAT.copy()
        coefficients[1:4] = lamp[:, None]
        for turn in (
            [0.6, 0.5, 0],
            [-0.6, 0.5, 0],
            [0.6, 2.3, 0],
            [-0.6, 2.3, 0],
            [0.6, 4.0, 0],
            [-0.6, 5.3, 0],
        ):
            pose = from_rotvec(np.array([turn[0], 0, 0]), np.array([0.0, 0, 0.4])) @ from_rotvec(
                np.array([0, turn[1], 0]), np.zeros(3)
            )
            scene_from_camera = np.linalg.inv(pose)  # the object lies in its scene's frame
            drawing = draw(
                FINER, [Placed(body, pose)], {"cube": Light(scene_from_camera[:3, :3], coefficients)}
            )
            color = laid_over(np.zeros((120, 160, 3), np.uint8), drawing, QUIET, np.random.default_rng(0))
            photos.append(Photo(scene, TABLE, scene_from_camera, pose, color, drawing.alpha > 0.5))
    painted, lights = paint(body.painted.mesh, body.painted.seen, photos)
    assert painted.seen.mean() > 0.95
    normals = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 0, 1], [0, 0, -1]])
    true = (1 + normals @ lamps["00"]) / (1 + normals @ lamps["01"])
    first, second = (harmonics(normals) @ lights[scene] for scene in ("00", "01"))
    brightest = np.arange(4), COLORS[[1, 0, 5, 4]].argmax(axis=1)  # a dark channel says little of the light
    np.testing.assert_allclose((first / second)[brightest], true, rtol=0.05)
    carved, _ = paint(body.painted.mesh, None, photos)  # no depth: what images agree on
    assert carved.seen.mean() > 0.9
    assert not paint(body.painted.mesh, None, photos[:1])[0].seen.any()  # one image agrees with itself
    rng = np.random.default_rng(0)  # a clear object shows what lies behind it
    through = [replace(photo, color=np.full_like(photo.color, rng.integers(0, 256, 3))) for photo in photos]
    assert not paint(body.painted.mesh, None, through)[0].seen.any()


def test_light_draws_turn_about_the_vertical_only() -> None:
    lamp = FLAT.copy()
    lamp[1:4] = (0.4 * UP)[:, None]  # from above
    for seed in range(3):
        own = {"cube": {"00": SceneLight(UP, lamp)}}
        light = draw_lights(own, np.array([0.6, -0.8, 0]), np.random.default_rng(seed))["cube"]
        top, bottom = shade(np.array([[0.6, -0.8, 0], [-0.6, 0.8, 0]], np.float32), light)
        assert top / bottom == pytest.approx(1.4 / 0.6, rel=1e-5)


def test_normals_of_a_face_are_steadied_and_edges_stay() -> None:
    mesh = cube_body(pieces=8).painted.mesh
    rng = np.random.default_rng(0)
    rough = Mesh(mesh.vertices + rng.normal(0, 4e-4, mesh.vertices.shape), mesh.triangles)
    inner = (np.abs(mesh.vertices) > 0.99 * HALF_M).sum(axis=1) == 1
    true = np.sign(np.round(mesh.vertices / HALF_M, 3) * (np.abs(mesh.vertices) > 0.99 * HALF_M))
    off = np.degrees(np.arccos((steady_normals(rough)[inner] * true[inner]).sum(axis=1).clip(-1, 1)))
    assert np.median(off) < 1.0


def test_noise_is_measured_and_laid_on() -> None:
    rng = np.random.default_rng(0)
    plain = np.full((120, 160, 3), 120, np.uint8)
    noisy = (120 + rng.normal(0, 3, plain.shape)).round().astype(np.uint8)
    assert color_noise(noisy) == pytest.approx(3, rel=0.2) and color_noise(plain) == 0
    seen, noise = alone(TABLE, Placed(cube_body(), FACING)), DepthNoise(1.5, 0.1, 0.5)
    depth_m = depth_over(np.full((120, 160), 0.9, np.float32), [(seen, noise)], rng)
    model = np.full((120, 160), np.inf, np.float32)
    model[seen.window] = seen.depth_m
    found = depth_errors(model, np.isfinite(model), depth_m)
    assert found.sigma == pytest.approx(1.5, rel=0.25)
    assert found.lost_inside == pytest.approx(0.1, abs=0.07)
    assert found.lost_at_rim == pytest.approx(0.5, abs=0.15)
    assert (depth_m[~np.isfinite(model)] == np.float32(0.9)).all()


def test_depth_is_lost_where_each_object_loses_it() -> None:
    rng = np.random.default_rng(0)
    pair = [
        alone(TABLE, Placed(cube_body(), from_rotvec(np.zeros(3), np.array([x, 0, 0.5]))))
        for x in (-0.1, 0.1)
    ]
    plate_m = np.full((120, 160), 0.9, np.float32)
    depth_m = depth_over(
        plate_m, list(zip(pair, (DepthNoise(), DepthNoise(1.0, 1.0, 1.0)), strict=True)), rng
    )
    kept, lost = (depth_m[one.window][one.mask] for one in pair)
    assert (kept > 0.4).all() and (lost == 0).all()
    model = np.where(np.isfinite(pair[1].depth_m), pair[1].depth_m, np.inf).astype(np.float32)
    dark = depth_errors(model, np.isfinite(model), np.zeros_like(model))
    measured = {"dark": [dark], "plain": [DepthNoise(1.2), DepthNoise(1.6)], "far": []}
    found = depth_noise(measured)
    assert found == {"dark": DepthNoise(1.4, 1.0, 1.0), "plain": DepthNoise(1.4), "far": DepthNoise(1.4)}


def test_shadows_fall_away_from_the_lamp() -> None:
    light = even_light()
    light.coefficients[1:4] = np.array([0.5, 0, -0.5])[:, None]  # from the right, and from the camera
    plane = Plane(np.array([0.0, 0, -1.0]), -0.55)
    plate = np.full((120, 160, 3), 100, np.uint8)
    dark = shadowed(plate, TABLE, [Placed(cube_body(), FACING)], plane, light)
    assert dark[60, 56, 0] < 90 and dark[60, 100, 0] == 100 == dark[5, 5, 0]
    assert (shadowed(plate, TABLE, [Placed(cube_body(), FACING)], None, light) == plate).all()


def test_what_is_laid_over_leaves_the_rest_as_it_was() -> None:
    plate = np.random.default_rng(0).integers(0, 255, (120, 160, 3)).astype(np.uint8)
    drawing = draw(FINER, [Placed(cube_body(), FACING)], EVEN)
    result = laid_over(plate, drawing, QUIET, np.random.default_rng(0))
    far = cv2.dilate((drawing.alpha > 0).astype(np.uint8), np.ones((11, 11))) == 0
    assert (result[far] == plate[far]).all() and (result[60, 80] == COLORS[5]).all()
