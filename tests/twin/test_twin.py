"""The twin against itself, OpenCV and pycocotools: its truth is what everything else is measured by."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from pycocotools import mask as coco_mask
from scipy.spatial import cKDTree

from rpl_data.formats.recordings.rpl import read_rpl
from rpl_data.geometry import back_project, invert, project, transform
from rpl_data.images import read_color, read_depth_m
from rpl_data.meshes import load_mesh
from rpl_data.twin import TwinSpec, write_twin
from rpl_data.twin.annotator import Mistakes, click
from rpl_data.twin.film import Film, film
from rpl_data.twin.objects import OBJECTS, build
from rpl_data.twin.resting import resting_rotations
from rpl_data.twin.scene import compose
from rpl_data.twin.trajectory import hand_held
from rpl_data.types import DataError, FrameLabel, KeypointModel
from rpl_data.workspace.workspace import Workspace

TINY = TwinSpec(scenes=2, seconds=1.0, rate_hz=4.0, width=160, height=120, clutter=2)


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tiny twin on disk, rendered in this process."""
    folder = tmp_path_factory.mktemp("twin") / "recording"
    write_twin(folder, TINY, workers=1)
    return folder


@pytest.fixture(scope="module")
def video() -> Film:
    """A sharper one, not rendered yet."""
    return film(replace(TINY, width=320, height=240, seconds=3.0, seed=1), 0)


# Objects ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", OBJECTS)
def test_objects_are_centred_textured_and_asymmetric(name: str) -> None:
    one = build(name)
    points = one.model.points_object
    assert 6 <= len(points) <= 12
    np.testing.assert_allclose(points.mean(axis=0), 0, atol=1e-12)
    # Landmarks lie on the surface: each is a vertex of it.
    assert cKDTree(one.surface.vertices).query(points)[0].max() < 1e-9
    distances = np.linalg.norm(points[:, None] - points[None], axis=-1)
    assert distances[~np.eye(len(points), dtype=bool)].min() > 0.008  # distinct, also for a person
    assert one.surface.texture.std(axis=(0, 1)).max() > 40


@pytest.mark.parametrize("name", OBJECTS)
def test_triangles_and_shading_normals_face_outwards(name: str) -> None:
    surface = build(name).surface
    a, b, c = (surface.vertices[surface.triangles[:, i]] for i in range(3))
    flat = np.cross(b - a, c - a)
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    assert (np.einsum("mk,mck->mc", flat, surface.corner_normals) > 0.25).all()
    # The volume by the divergence theorem is positive only for outward triangles.
    assert np.einsum("mk,mk->", a, np.cross(b, c)) / 6 > 5e-5


def test_carton_has_its_size() -> None:
    np.testing.assert_allclose(np.ptp(build("carton").surface.vertices, axis=0), [0.09, 0.06, 0.14])


def test_unknown_object_is_refused() -> None:
    with pytest.raises(DataError, match="no twin object 'teapot'; expected one of carton, kettle, bottle"):
        build("teapot")


# Scene and trajectory -----------------------------------------------------------------------------


def test_a_box_rests_on_its_six_faces_the_widest_first() -> None:
    rotations = resting_rotations(build("carton").surface.vertices)
    heights = [np.ptp(build("carton").surface.vertices @ r.T, axis=0)[2] for r in rotations]
    np.testing.assert_allclose(heights, [0.06, 0.06, 0.09, 0.09, 0.14, 0.14], atol=1e-9)


def test_objects_stand_on_the_table_apart_and_in_another_pose_each_scene() -> None:
    objects = [build("carton"), build("kettle")]
    ups = []
    for number in range(4):
        rng = np.random.default_rng(number)
        scene = compose(objects, rng=rng, number=number, turns=[number] * 2, clutter=4)
        for surface in scene.surfaces[:2]:
            assert abs(surface.vertices[:, 2].min()) < 1e-9
        clouds = [surface.vertices for surface in scene.surfaces[:2]]
        assert cKDTree(clouds[0]).query(clouds[1])[0].min() > 0.005
        ups.append(scene.table_from_object[0][2, :3])
    assert all(a @ b < 0.99 for i, a in enumerate(ups) for b in ups[:i])


def test_a_plain_room_has_no_texture_and_the_same_things_in_it() -> None:
    usual, plain = (
        compose([build("carton")], rng=np.random.default_rng(3), number=1, turns=[0], clutter=2, plain=plain)
        for plain in (False, True)
    )
    np.testing.assert_array_equal(usual.table_from_object, plain.table_from_object)
    spreads = [
        [np.ptp(s.texture, axis=(0, 1)).max() for s in scene.surfaces[-3:]] for scene in (usual, plain)
    ]
    assert min(spreads[0]) > 10 and max(spreads[1]) == 0


def test_trajectory_is_smooth_looks_at_the_target_and_keeps_its_distance() -> None:
    target, times = np.array([0.1, -0.05, 0.06]), np.arange(240) / 30
    poses = hand_held(
        np.random.default_rng(0),
        times_s=times,
        target_m=target,
        sweep_deg=150.0,
        distance_m=(0.6, 0.8),
        elevation_deg=(30.0, 55.0),
        span_s=(0.0, float(times[-1])),
    )
    np.testing.assert_allclose(
        poses[:, :3, :3] @ poses[:, :3, :3].swapaxes(1, 2), np.tile(np.eye(3), (240, 1, 1)), atol=1e-12
    )
    seen = transform(invert(poses[100]), target[None])[0]
    assert seen[2] > 0.5 and np.hypot(*seen[:2]) < 0.1
    distance = np.linalg.norm(poses[:, :3, 3] - target, axis=1)
    assert distance.min() > 0.52 and distance.max() < 0.88
    step = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    assert step.max() < 0.04 and step.std() > 1e-4  # never jumps, never even
    around = np.unwrap(np.arctan2(*(poses[:, :2, 3] - target[:2]).T))
    assert np.rad2deg(abs(around[-1] - around[0])) == pytest.approx(150, abs=8)


# Renderer -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [0, 1])
def test_full_masks_agree_with_triangles_filled_by_opencv_to_half_a_pixel(video: Film, number: int) -> None:
    fine, surface = 16, video.scene.surfaces[number]
    for frame in (0, 6):
        mask = video.renderer.full_mask(number, video.table_from_camera[frame])
        uv = project(
            video.spec.intrinsics, transform(invert(video.table_from_camera[frame]), surface.vertices)
        )
        filled = np.zeros((mask.shape[0] * fine, mask.shape[1] * fine), np.uint8)
        # Pixel (u, v) of the image has its centre at (u + 0.5) * 16 - 0.5 of the fine one.
        corners = np.round((uv[surface.triangles] + 0.5) * fine - 0.5).astype(np.int32)
        for triangle in corners:
            cv2.fillConvexPoly(filled, triangle, 1)
        to_edge = cv2.distanceTransform(filled, cv2.DIST_L2, 5) + cv2.distanceTransform(
            1 - filled, cv2.DIST_L2, 5
        )
        centre = np.s_[fine // 2 :: fine, fine // 2 :: fine]
        wrong = mask != filled[centre].astype(bool)
        assert mask.sum() > 500
        assert wrong.sum() < 0.02 * mask.sum()
        assert not wrong.any() or to_edge[centre][wrong].max() <= 0.5 * fine


def test_depth_is_exact_and_on_the_surface(video: Film) -> None:
    rendered = video.shoot(3).perfect
    v, u = np.nonzero(rendered.thing == 0)
    points = back_project(
        video.spec.intrinsics, np.column_stack([u, v]).astype(float), rendered.depth_m[v, u].astype(float)
    )
    in_object = transform(invert(video.scene.table_from_object[0]) @ video.table_from_camera[3], points)
    low, high = (end(build("carton").surface.vertices, axis=0) for end in (np.min, np.max))
    from_centre = np.abs(in_object - (low + high) / 2) / ((high - low) / 2)
    assert np.abs(from_centre.max(axis=1) - 1).max() < 1e-4  # every point lies on a face of the box


def test_visible_mask_is_the_full_mask_less_what_stands_before_it(video: Film) -> None:
    for frame in (0, 4, 9):
        for instance in video.shoot(frame).label.instances:
            full, seen = (coco_mask.decode(dict(m)).astype(bool) for m in (instance.mask_full, instance.mask))
            assert not (seen & ~full).any()
            assert instance.visib_fract == pytest.approx(seen.sum() / full.sum())
            x0, y0, w, h = coco_mask.toBbox(dict(instance.mask))
            assert instance.box == (x0, y0, x0 + w, y0 + h)


def test_a_corner_behind_its_own_box_is_hidden_and_the_nearest_is_seen(video: Film) -> None:
    for frame in range(0, video.spec.frames(0), 3):
        instance = video.shoot(frame).label.instances[0]
        points = transform(instance.camera_from_object, build("carton").model.points_object)
        nearest, farthest = np.argsort(np.linalg.norm(points, axis=1))[[0, -1]]
        if instance.visib_fract > 0.99:
            assert instance.visibility[nearest] == 2
            assert instance.visibility[farthest] == 1
        assert (instance.visibility == 1).sum() <= 4 or instance.visib_fract < 0.99


def test_one_keypoint_makes_no_square_so_it_is_the_masks(video: Film) -> None:
    whole = video.objects[0]
    model = KeypointModel("carton", whole.model.keypoints[:1], whole.model.points_object[:1])
    one = replace(video, objects=(replace(whole, model=model), *video.objects[1:]))
    label = one.shoot(0).label.instances[0]
    box = np.array(label.box_full)
    assert label.square_box.side_px == pytest.approx(1.5 * (box[2:] - box[:2]).max())


# Annotator ----------------------------------------------------------------------------------------


def _static_labels(video: Film, count: int) -> list[FrameLabel]:
    label = video.shoot(0).label
    return [replace(label, frame=frame) for frame in range(count)]


def test_clicks_are_spread_noisy_and_only_on_what_is_seen(video: Film) -> None:
    labels = _static_labels(video, 600)
    clicks = click(
        labels,
        "carton",
        intrinsics=video.spec.intrinsics,
        clicks_per_keypoint=300,
        noise_px=2.0,
        rng=np.random.default_rng(0),
    )
    truth = labels[0].instances[0]
    assert {c.keypoint for c in clicks} <= set(np.flatnonzero(truth.visibility == 2))
    error = np.array([[c.u_px, c.v_px] - truth.keypoints_px[c.keypoint] for c in clicks])
    np.testing.assert_allclose(error.std(axis=0), 2.0, rtol=0.1)
    frames = sorted(c.frame for c in clicks if c.keypoint == clicks[0].keypoint)
    assert len(frames) == 300 and np.diff(frames).max() <= 3


def test_a_careless_person_misses_swaps_and_slips_as_often_as_asked(video: Film) -> None:
    labels = _static_labels(video, 600)
    full = coco_mask.decode(dict(labels[0].instances[0].mask_full)).astype(bool)

    def clicked(seed: int, each: int = 200, **mistakes: float) -> list[tuple[int, int, float, float]]:
        found = click(
            labels[: 3 * each],
            "carton",
            intrinsics=video.spec.intrinsics,
            clicks_per_keypoint=each,
            noise_px=0.5,
            rng=np.random.default_rng(seed),
            mistakes=Mistakes(**mistakes),
        )
        return [(c.keypoint, c.frame, c.u_px, c.v_px) for c in found]

    careful = clicked(0)
    missed = clicked(0, missed=0.2)
    assert set(missed) < set(careful)  # the others stay where they were
    assert len(missed) / len(careful) == pytest.approx(0.8, abs=0.05)

    slipped = clicked(0, slipped=0.3)
    moved = [b for a, b in zip(careful, slipped, strict=True) if a != b]
    assert moved and len(moved) / len(careful) <= 0.36
    assert not any(full[round(v), round(u)] for _, _, u, v in moved)
    near = [a for a, b in zip(careful, slipped, strict=True) if a != b]
    far_px = [np.hypot(a[2] - b[2], a[3] - b[3]) for a, b in zip(near, moved, strict=True)]
    assert max(far_px) < 16

    swapped = [clicked(seed, each=2, swapped=0.25) for seed in range(40)]
    taken = [
        {a[0]: b[0] for a, b in zip(clicked(s, each=2), other, strict=True)}
        for s, other in enumerate(swapped)
    ]
    wrong = [{a: b for a, b in of.items() if a != b} for of in taken]
    assert {len(pair) for pair in wrong} == {0, 2}  # two, with each other
    assert sum(map(bool, wrong)) / 40 == pytest.approx(0.25, abs=0.15)


# On disk ------------------------------------------------------------------------------------------


def test_the_tree_is_an_ordinary_recording_whose_depth_is_the_truth_plus_noise(tree: Path) -> None:
    recordings = read_rpl(tree)
    assert [recording.scene.name for recording in recordings] == ["00", "01"]
    for number, recording in enumerate(recordings):
        video, trajectory = film(TINY, number), recording.trajectory
        assert trajectory is not None and not recording.skipped
        np.testing.assert_allclose(trajectory.scene_from_camera, video.scene_from_camera, atol=1e-9)
        np.testing.assert_allclose(trajectory.scene_from_camera[0], np.eye(4), atol=1e-12)
        frame = recording.scene.frame(2)
        shot = video.shoot(2)
        depth_m = read_depth_m(recording.scene, frame)
        np.testing.assert_allclose(depth_m, shot.depth_m, atol=6e-4)
        difference = read_color(frame).astype(float) - shot.color
        assert np.abs(difference).mean() < 6  # JPEG
        true_m = shot.perfect.depth_m
        # Away from outlines and holes what remains is the axial noise and the millimetre.
        calm = cv2.erode((np.abs(depth_m - true_m) < 0.02).astype(np.uint8), np.ones((3, 3))) > 0
        calm &= (true_m < 1.2) & (shot.perfect.cos_incidence > 0.6)
        noise_px = TINY.sensor.depth.subpixel_px
        sigma_m = np.hypot(noise_px / 19.3 * true_m**2, 0.001 / np.sqrt(12))
        assert calm.mean() > 0.3
        assert np.std(((depth_m - true_m) / sigma_m)[calm]) == pytest.approx(1.1, abs=0.2)


def test_truth_is_a_workspace_that_agrees_with_itself(tree: Path) -> None:
    truth = Workspace(tree / "truth")
    assert truth.object_names() == ["carton", "kettle"]
    assert truth.labelled_scene_names() == ["00", "01"]
    recordings = {recording.scene.name: recording for recording in read_rpl(tree)}
    for name in truth.object_names():
        solution = truth.load_solution(name)
        assert len(load_mesh(truth.mesh_file(name)).triangles) > 500
        for scene, recording in recordings.items():
            assert recording.trajectory is not None
            for label in truth.load_labels(scene):
                for instance in (i for i in label.instances if i.object == name):
                    pose = recording.trajectory.at(label.frame)
                    expected = invert(pose) @ solution.scene_from_object[scene]
                    np.testing.assert_allclose(instance.camera_from_object, expected, atol=1e-8)
                    points = transform(expected, solution.model.points_object)
                    np.testing.assert_allclose(
                        instance.keypoints_px, project(TINY.intrinsics, points), atol=2e-3
                    )


def test_clicks_csv_names_seen_keypoints(tree: Path) -> None:
    rows = list(csv.DictReader((tree / "clicks.csv").read_text().splitlines()))
    assert {row["object"] for row in rows} == {"carton", "kettle"}
    labels = {scene: list(Workspace(tree / "truth").load_labels(scene)) for scene in ("00", "01")}
    for row in rows:
        instances = labels[row["scene"]][int(row["frame"])].instances
        instance = next(i for i in instances if i.object == row["object"])
        keypoint = build(row["object"]).model.keypoints.index(row["keypoint"])
        assert instance.visibility[keypoint] == 2
        assert np.hypot(*(instance.keypoints_px[keypoint] - [float(row["u_px"]), float(row["v_px"])])) < 10


def test_same_seed_same_files_however_interrupted_another_seed_others(tree: Path, tmp_path: Path) -> None:
    short = replace(TINY, scenes=1)
    progress: list[tuple[int, int]] = []

    def interrupt(done: int, total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_twin(tmp_path / "again", short, workers=1, progress=interrupt)
    assert not (tmp_path / "again").exists()
    (begun,) = tmp_path.glob(".again.*.partial")
    (begun / "00/rgb/.000002.jpg.abcdefgh").write_bytes(b"half")  # as of a process that was killed
    (tmp_path / ".again.partial").mkdir()  # of another spec, or version
    rendered_ns = (begun / "00/rgb/000001.jpg").stat().st_mtime_ns
    write_twin(
        tmp_path / "again", short, workers=2, progress=lambda done, total: progress.append((done, total))
    )
    assert progress == [(done, 4) for done in range(1, 5)]
    assert (tmp_path / "again/00/rgb/000001.jpg").stat().st_mtime_ns == rendered_ns
    made = [path.relative_to(tree) for path in tree.glob("00/**/*") if path.is_file()]
    for name in (*made, "truth/labels/00.jsonl"):
        assert (tmp_path / "again" / name).read_bytes() == (tree / name).read_bytes()
    folders = tmp_path / "again", tree
    clicked, of_both = ((folder / "clicks.csv").read_text().splitlines() for folder in folders)
    assert set(clicked) == {row for row in of_both if ",01," not in row}
    assert [path.name for path in tmp_path.iterdir()] == ["again"]
    inside, of_two = ({path.name for path in folder.iterdir()} for folder in folders)
    assert inside == of_two - {"01"}
    write_twin(tmp_path / "again", replace(short, seed=7, seconds=0.5), workers=1)  # replaces the folder
    assert len(list((tmp_path / "again/00/rgb").iterdir())) == 2
    assert (tmp_path / "again/00/depth/000001.png").read_bytes() != (
        tree / "00/depth/000001.png"
    ).read_bytes()


def test_jpeg_costs_colour_what_its_quality_says(tree: Path, tmp_path: Path) -> None:
    coarse = replace(TINY.sensor, color=replace(TINY.sensor.color, jpeg_quality=30))
    write_twin(tmp_path / "coarse", replace(TINY, scenes=1, sensor=coarse), workers=1)
    shot = film(TINY, 0).shoot(0)
    size, error = [], []
    for folder in (tmp_path / "coarse", tree):
        path = folder / "00/rgb/000000.jpg"
        size.append(path.stat().st_size)
        error.append(np.abs(cv2.imread(str(path))[..., ::-1].astype(float) - shot.color).mean())
    assert size[0] < 0.5 * size[1]
    assert error[0] > 1.3 * error[1]


def test_a_failure_leaves_nothing_and_says_what_is_wrong(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="at least 2 frames"):
        write_twin(tmp_path / "none", replace(TINY, seconds=0.1), workers=1)
    with pytest.raises(DataError, match="no twin object 'jug'"):
        write_twin(tmp_path / "none", replace(TINY, objects=("jug",)), workers=1)
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(DataError, match="cannot write the twin"):
        write_twin(tmp_path / "file" / "none", TINY, workers=1)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
