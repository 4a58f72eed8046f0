"""The doctor finds each planted fault in a made-up recording, and nothing in the sound one."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from made_floor import CAMERA, pose, shoot
from scipy.spatial.transform import Rotation

from rpl_data.cli.main import main
from rpl_data.doctor.alignment import align
from rpl_data.doctor.edges import edges_of
from rpl_data.doctor.examine import examine, stretches
from rpl_data.doctor.findings import Diagnosis, Finding
from rpl_data.doctor.text import describe
from rpl_data.formats.recordings.camera_file import write_camera
from rpl_data.formats.recordings.rpl import write_associations, write_poses
from rpl_data.geometry import invert
from rpl_data.recordings.mend import Mend, mended, mended_poses
from rpl_data.types import Frame, Intrinsics, Recording, Trajectory

FRAMES = 24


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sound recording as a RapidPoseLabels tree."""
    root = tmp_path_factory.mktemp("doctor")
    scene = root / "00"
    for kind in ("rgb", "depth"):
        (scene / kind).mkdir(parents=True)
    poses = np.array([pose(n) for n in range(FRAMES)])
    for n, at in enumerate(poses):
        color, depth_m = shoot(at)
        cv2.imwrite(str(scene / f"rgb/{n:06d}.png"), color)
        cv2.imwrite(str(scene / f"depth/{n:06d}.png"), np.rint(depth_m * 1000).astype(np.uint16))
    times_s = [n / 30 for n in range(FRAMES)]
    names = [f"{n:06d}.png" for n in range(FRAMES)]
    write_camera(root, CAMERA)
    write_associations(scene, times_s, [f"rgb/{name}" for name in names], [f"depth/{name}" for name in names])
    write_poses(scene, times_s, poses)
    return root


@pytest.fixture(scope="module")
def sound(folder: Path) -> Recording:
    from rpl_data.recordings.open import open_scenes

    return open_scenes(folder, "rpl", metres_per_unit=0.001)[0]


def kinds(found: Diagnosis) -> list[str]:
    return [finding.kind for finding in found.findings]


def with_poses(recording: Recording, poses: np.ndarray) -> Recording:
    assert recording.trajectory is not None
    return replace(recording, trajectory=Trajectory(recording.trajectory.frames, poses))


def poses_of(recording: Recording) -> np.ndarray:
    assert recording.trajectory is not None
    return recording.trajectory.scene_from_camera


def with_camera(recording: Recording, **numbers: float) -> Recording:
    camera = replace(recording.scene.intrinsics, **numbers)
    return replace(recording, scene=replace(recording.scene, intrinsics=camera))


def with_unit(recording: Recording, factor: float) -> Recording:
    unit = recording.scene.metres_per_unit * factor
    return replace(recording, scene=replace(recording.scene, metres_per_unit=unit))


def with_frames(recording: Recording, frames: list[Frame]) -> Recording:
    return replace(recording, scene=replace(recording.scene, frames=tuple(frames)))


def late_depth(recording: Recording, lag: int) -> Recording:
    frames = recording.scene.frames
    return with_frames(
        recording, [replace(frames[n], depth=frames[n - lag].depth) for n in range(lag, len(frames))]
    )


def as_wxyz(poses: np.ndarray) -> np.ndarray:
    stored = poses.copy()
    quaternions_wxyz = np.roll(Rotation.from_matrix(poses[:, :3, :3]).as_quat(), 1, axis=1)
    stored[:, :3, :3] = Rotation.from_quat(quaternions_wxyz).as_matrix()
    return stored


def test_a_sound_recording_has_nothing_wrong(sound: Recording) -> None:
    found = examine(sound)
    assert found.findings == ()
    assert "nothing wrong" in describe(found)


FAULTS: dict[str, tuple[Callable[[Recording], Recording], str]] = {
    "depth x5": (lambda r: with_unit(r, 5), r"depths are (4\.9|5\.0)\d times"),
    "depth /5": (lambda r: with_unit(r, 0.2), r"depths are 1/(4\.9|5\.0)\d of"),
    "depth 3 frames late": (lambda r: late_depth(r, 3), "depth is 3.0 frames behind colour"),
    "inverted poses": (lambda r: with_poses(r, invert(poses_of(r))), "camera_from_scene"),
    "wxyz quaternions": (lambda r: with_poses(r, as_wxyz(poses_of(r))), "w x y z"),
    "focal length x1.25": (lambda r: with_camera(r, fx=375.0, fy=375.0), "focal length 375 px"),
    "intrinsics of twice the size": (
        lambda r: with_camera(r, fx=600.0, fy=600.0, cx=316.0, cy=242.0), "2.00 times this size"
    ),
    "dropped frames": (
        lambda r: with_frames(r, [f for f in r.scene.frames if f.index not in (9, 20, 21)]),
        r"about 3 frames missing in 2 gaps",
    ),
    "poses 2 frames late": (
        lambda r: with_poses(r, np.concatenate([poses_of(r)[:2], poses_of(r)[:-2]])),
        "poses belong to images 2 frames earlier",
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_is_found_first_and_alone(sound: Recording, fault: str) -> None:
    plant, said = FAULTS[fault]
    found = examine(plant(sound))
    assert len(found.findings) == 1, describe(found)
    assert re.search(said, found.findings[0].what)
    assert found.findings[0].sure >= 0.9


def test_depth_and_poses_that_are_late_together_are_one_finding(sound: Recording) -> None:
    late = late_depth(with_poses(sound, np.concatenate([poses_of(sound)[:3], poses_of(sound)[:-3]])), 3)
    (finding,) = examine(late).findings
    assert finding.kind == "depth lag" and "depth and poses are 3.0 frames behind" in finding.what
    assert finding.mend == Mend(depth_lag=3, pose_lag=3)
    assert examine(mended(late, finding.mend)).findings == ()


def test_a_repeated_depth_image_is_found_and_leaving_it_out_makes_no_gap(sound: Recording) -> None:
    """It is found alone, and the option that the finding names leaves nothing to find."""
    frames = sound.scene.frames
    repeated = with_frames(sound, [replace(f, depth=frames[6].depth) if f.index == 7 else f for f in frames])
    (finding,) = examine(repeated).findings
    assert "frames 7" in finding.what and finding.sure >= 0.9
    assert finding.mend is not None
    found = examine(mended(repeated, finding.mend))
    assert found.findings == (), describe(found)
    assert any("mend: {no_repeats: true}" in fact for fact in found.facts)


def test_poses_that_stray_are_found(sound: Recording) -> None:
    poses = poses_of(sound).copy()
    poses[:, :3, 3] += np.linspace(0, 0.06, FRAMES)[:, None] * poses[:, :3, 2]
    (finding,) = examine(with_poses(sound, poses)).findings
    assert finding.kind == "drift"
    assert "`rpl build` cuts the recording into" in finding.todo


def test_poses_that_stray_as_a_wrong_unit_would_are_drift(sound: Recording) -> None:
    """They move a quarter too far and turn 3 degrees too far: a factor of the depth mends only the former."""
    poses = poses_of(sound).copy()
    poses[:, :3, 3] = poses[0, :3, 3] + 1.25 * (poses[:, :3, 3] - poses[0, :3, 3])
    turns = Rotation.from_rotvec(np.linspace(0, np.deg2rad(3), FRAMES)[:, None] * [0.0, 1.0, 0.0])
    poses[:, :3, :3] = poses[:, :3, :3] @ turns.as_matrix()
    assert kinds(examine(with_poses(sound, poses))) == ["drift"]


def test_two_faults_are_found_one_after_the_other(sound: Recording) -> None:
    found = examine(with_unit(with_poses(sound, invert(poses_of(sound))), 5))
    assert sorted(kinds(found)) == ["depth scale", "pose convention"]


def test_the_option_a_finding_names_mends_it(sound: Recording) -> None:
    stored = as_wxyz(invert(poses_of(sound)))
    (finding,) = examine(with_poses(sound, stored)).findings
    assert "mend: {wxyz_quaternions: true, inverted_poses: true}" in finding.todo
    mended = mended_poses(stored, Mend(wxyz_quaternions=True, inverted_poses=True))
    np.testing.assert_allclose(mended, poses_of(sound), atol=1e-9)  # in which nothing is found


def test_shifted_depth_is_measured() -> None:
    shots = [shoot(pose(n)) for n in range(FRAMES)]
    found = align({n: edges_of(color, np.roll(depth_m, 20, axis=1).astype(np.float32))
                   for n, (color, depth_m) in enumerate(shots)})  # fmt: skip
    np.testing.assert_allclose(found.shift_px, [-20, 0], atol=2.5)
    assert abs(found.lag_frames) < 0.25
    assert found.shift_contrast > 1.2


def test_images_without_edges_measure_nothing() -> None:
    """A bare wall: no shift and no lag can be told, which must not read as certain."""
    plain = np.full((240, 320, 3), 120, np.uint8)
    found = align({n: edges_of(plain, shoot(pose(n))[1].astype(np.float32)) for n in range(8)})
    assert np.isinf([found.lag_sigma, found.shift_sigma_px]).all() and not found.prefers(1) > 0.9


def test_depth_of_another_field_of_view_is_found_and_the_named_option_mends_it(
    sound: Recording, tmp_path: Path
) -> None:
    """Depth of a camera with a longer lens, 12 px beside the colour camera: as a Kinect's."""
    other = replace(CAMERA, fx=1 / 0.88 * CAMERA.fx, fy=1 / 0.88 * CAMERA.fy)
    back = np.array([[1 / 0.88, 0, 0.12 / 0.88 * -159.5 + 12], [0, 1 / 0.88, 0.12 / 0.88 * -119.5]])
    frames = []
    for frame in sound.scene.frames:
        depth = cv2.imread(str(frame.depth), cv2.IMREAD_UNCHANGED)
        moved = cv2.warpAffine(depth, back, (CAMERA.width, CAMERA.height), flags=cv2.INTER_NEAREST)
        cv2.imwrite(str(tmp_path / f"{frame.index}.png"), moved)
        frames.append(replace(frame, depth=tmp_path / f"{frame.index}.png"))
    other = replace(other, cx=(CAMERA.cx - 159.5) / 0.88 + 159.5 + 12, cy=(CAMERA.cy - 119.5) / 0.88 + 119.5)
    wrong = replace(
        with_frames(sound, frames), scene=replace(sound.scene, intrinsics=other, frames=tuple(frames))
    )
    (finding,) = examine(wrong).findings
    assert finding.kind == "registration"
    words = re.search(
        r"mend: {depth_zoom: ([0-9.]+), depth_shift_px: \[([-0-9.]+), ([-0-9.]+)\]}", finding.todo
    )
    numbers = re.search(r"camera: \[([0-9.]+), ([0-9.]+), ([0-9.]+), ([0-9.]+)\]", finding.todo)
    assert words is not None and numbers is not None, finding.todo
    zoom, du, dv = map(float, words.groups())
    assert zoom == pytest.approx(0.88, abs=0.01)
    np.testing.assert_allclose([du, dv], [-12 * 0.88, 0], atol=2)
    fx, fy, cx, cy = map(float, numbers.groups())
    np.testing.assert_allclose([fx, cx, cy], [CAMERA.fx, CAMERA.cx, CAMERA.cy], rtol=0.02, atol=2)
    scene = replace(wrong.scene, intrinsics=Intrinsics(fx, fy, cx, cy, CAMERA.width, CAMERA.height))
    put_right = mended(replace(wrong, scene=scene), Mend(depth_zoom=zoom, depth_shift_px=(du, dv)))
    assert examine(put_right).findings == ()


def test_a_camera_that_stands_still_proves_nothing(sound: Recording) -> None:
    found = examine(with_poses(sound, np.repeat(poses_of(sound)[:1], FRAMES, axis=0)))
    assert any("hardly moves" in fact for fact in found.facts)


def test_without_poses_it_says_what_was_not_judged(sound: Recording) -> None:
    found = examine(replace(sound, trajectory=None))
    assert any("no poses" in fact for fact in found.facts)
    assert found.findings == ()
    assert found.unjudged == ("depth unit, intrinsics and poses (no poses)",)
    (headline, *_) = describe(found).splitlines()
    assert headline == (
        "scene 00: not judged: depth unit, intrinsics and poses (no poses); no fault in the rest"
    )


def test_a_broken_image_is_counted(sound: Recording, tmp_path: Path) -> None:
    (tmp_path / "half.png").write_bytes(b"\x89PNG")
    frames = [replace(f, depth=tmp_path / "half.png") if f.index == 5 else f for f in sound.scene.frames]
    said: list[tuple[int, int]] = []
    found = examine(with_frames(sound, frames), progress=lambda done, total: said.append((done, total)))
    assert kinds(found) == ["unreadable"]
    assert (FRAMES, FRAMES) in said  # progress reaches its total all the same


def test_a_long_recording_is_looked_at_in_two_places() -> None:
    assert stretches(80) == [range(80)]
    assert stretches(9000) == [range(45), range(8955, 9000)]


def test_a_jump_of_the_camera(sound: Recording) -> None:
    poses = poses_of(sound).copy()
    poses[20:, 0, 3] += 2.0
    assert "pose jump" in kinds(examine(with_poses(sound, poses)))


def test_the_text_says_how_sure_and_what_to_do() -> None:
    finding = Finding("depth lag", "depth is late", 0.93, "wait")
    text = describe(Diagnosis("00", ("10 frames",), (finding,)))
    assert "scene 00: 1 thing wrong" in text
    assert "! depth lag (sure 93%): depth is late" in text
    assert "what to do: wait" in text
    always = replace(finding, sure=1.0)
    assert "(sure, over 99%)" in describe(Diagnosis("00", (), (always,))), "inferred: never certain"
    blurred = Finding("blur", "80% of the frames are blurred", 1.0, "wait")
    assert "! blur (counted): 80%" in describe(Diagnosis("00", (), (blurred,)))


def test_check_of_a_folder_guesses_its_format(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(folder), "--metres_per_unit", "0.005"]) == 0
    assert "metres_per_unit" in capsys.readouterr().out


def test_check_of_a_recipe_reads_as_the_recipe_says(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recipe = tmp_path / "mine.yaml"
    recipe.write_text(
        f"name: mine\nobjects: [{{name: block, keypoints: 4}}]\n"
        f"scenes: [{{path: {folder}, metres_per_unit: 0.001, mend: {{inverted_poses: true}}}}]\n"
    )
    assert main(["check", str(recipe)]) == 0
    assert "camera_from_scene" in capsys.readouterr().out


def test_check_of_nothing_known_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(tmp_path)]) == 1
    assert "looks like no format that is known" in capsys.readouterr().err


def test_the_desk_has_its_repeated_depth_and_its_lag(real_data: Path) -> None:
    from rpl_data.recordings.open import open_scenes

    for recording in open_scenes(real_data / "desk", "rpl"):
        found = kinds(examine(recording))
        assert "repeated frames" in found
        assert set(found) <= {"repeated frames", "depth lag", "drift"}
