"""Colour and depth in two folders beside a file with K: the layouts that people and their estimators use."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from recordings import LENS, color_image, cut, depth_image, poses, write_color, write_depth

from rpl_data.formats.recordings.folders import is_folder_scene
from rpl_data.formats.recordings.matrices import read_matrix_camera
from rpl_data.images import read_color, read_depth_m
from rpl_data.recordings.open import likely_formats, open_scenes
from rpl_data.types import DataError, Recording

K = np.array([[50.0, 0, 31.5], [0, 51, 23.5], [0, 0, 1]])


def make_folders(folder: Path, color: str = "rgb/{:06d}.png", depth: str = "depth/{:06d}.png") -> None:
    """FoundationPose's and BundleSDF's layout: six frames, no poses."""
    for number in range(6):
        write_color(folder / color.format(number), number)
        write_depth(folder / depth.format(number), number)
    np.savetxt(folder / "cam_K.txt", K)


def read(folder: Path, **options: object) -> Recording:
    assert likely_formats(folder) == ["folders"]
    unpack = (folder.parent / "unpacked").joinpath
    (found,) = open_scenes(folder, "folders", unpack=unpack, **options)  # type: ignore[arg-type]
    return found


def test_foundation_pose(tmp_path: Path) -> None:
    make_folders(tmp_path / "milk")
    found = read(tmp_path / "milk")
    scene = found.scene
    assert (scene.name, len(scene.frames), scene.registered, found.trajectory) == ("milk", 6, True, None)
    assert (scene.intrinsics.fx, scene.intrinsics.fy, scene.intrinsics.cx, scene.intrinsics.cy) == LENS
    assert [frame.timestamp_s for frame in scene.frames] == [number / 30 for number in range(6)]
    assert scene.frames[3].depth == tmp_path / "milk/depth/000003.png"
    assert read_depth_m(scene, scene.frames[3])[0, 0] == pytest.approx(0.703)
    assert "no times: 30 frames per second assumed" in found.notes
    assert any("metres_per_unit not given" in note for note in found.notes)


def test_a_folder_of_scenes_with_one_camera(tmp_path: Path) -> None:
    for name in ("a", "b"):
        make_folders(tmp_path / name, "color/{}.jpg", "depth/{}.png")
        (tmp_path / name / "cam_K.txt").rename(tmp_path / "K.txt")
    found = open_scenes(tmp_path, "folders")
    assert [one.scene.name for one in found] == ["a", "b"]


def test_names_are_sorted_as_numbers_and_loners_are_said(tmp_path: Path) -> None:
    for number in (1, 2, 9, 10, 100):
        write_color(tmp_path / f"images/frame{number}.png", 1)
        write_depth(tmp_path / f"depth/frame{number:04d}.png", number)
    np.savetxt(tmp_path / "K.txt", K)
    (tmp_path / "images/frame9.png").unlink()
    (tmp_path / "depth/frame0002.png").unlink()
    found = read(tmp_path)
    assert [frame.index for frame in found.scene.frames] == [1, 10, 100]
    assert "1 frame with a colour image, but no depth image of that name: 2" in found.skipped
    assert "1 frame with a depth image, but no colour image of that name: 9" in found.skipped


def write_camera(kind: str, folder: Path) -> None:
    (folder / "cam_K.txt").unlink()
    four = np.eye(4)
    four[:3, :3] = K
    texts: dict[str, tuple[str, str]] = {
        "one line": ("intrinsics.txt", "50 51 31.5 23.5\n"),
        "commas": ("camera_matrix.csv", "50.0, 0.0, 31.5\n0.0, 51.0, 23.5\n0.0, 0.0, 1.0\n"),
        "3 x 4": ("camera_intrinsics.txt", "50 0 31.5 0 \n 0 51 23.5 0 \n 0 0 1 0"),
        "columns": ("intrinsic.json", json.dumps({"width": 64, "height": 48,
                    "intrinsic_matrix": K.T.ravel().tolist()})),
        "rows": ("camera_intrinsics.json", json.dumps({"K": K.tolist()})),
        "names": ("camera.json", json.dumps({"color": {"fx": 50, "fy": 51, "ppx": 31.5, "ppy": 23.5},
                  "depth": {"fx": 9, "fy": 9, "ppx": 9, "ppy": 9}})),
        "our own": ("camera.txt", "50 51 31.5 23.5\nmetres_per_unit 0.001\n"),
    }  # fmt: skip
    if kind == "4 x 4":
        (folder / "intrinsic").mkdir()
        np.savetxt(folder / "intrinsic/intrinsic_color.txt", four)
        return
    name, text = texts[kind]
    (folder / name).write_text(text)


@pytest.mark.parametrize(
    "kind", ["one line", "commas", "3 x 4", "4 x 4", "columns", "rows", "names", "our own"]
)
def test_any_of_the_usual_camera_files(kind: str, tmp_path: Path) -> None:
    make_folders(tmp_path)
    write_camera(kind, tmp_path)
    camera = read(tmp_path).scene.intrinsics
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == LENS


def test_units_and_distortion_that_a_camera_file_names(tmp_path: Path) -> None:
    make_folders(tmp_path)
    (tmp_path / "cam_K.txt").unlink()
    content = {"camera": {"w": 64, "h": 48, "fx": 50, "fy": 51, "cx": 31.5, "cy": 23.5, "scale": 2000,
               "k1": 0.1, "k2": 0, "p1": 0, "p2": 0}}  # fmt: skip
    (tmp_path / "cam_params.json").write_text(json.dumps(content))
    scene = read(tmp_path).scene
    assert scene.metres_per_unit == 0.0005 and scene.intrinsics.distortion == (0.1, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("lens", "expected"),
    [
        ({"k1": 0.1, "k3": 0.2}, (0.1, 0.0, 0.0, 0.0, 0.2)),
        ({"k1": 0.1, "k6": 0.3}, (0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.3)),
        ({"distortion": {"k1": 0.1, "k2": 0.2}}, (0.1, 0.2, 0.0, 0.0)),
        ({"distortion": [0.1, 0, 0, 0, 0, 0.3]}, None),
        ({"distortion": [0.1] * 12}, None),
    ],
)
def test_no_part_of_a_lens_is_dropped(
    lens: dict[str, object], expected: tuple[float, ...] | None, tmp_path: Path
) -> None:
    path = tmp_path / "camera.json"
    path.write_text(json.dumps({"fx": 50, "fy": 51, "cx": 31.5, "cy": 23.5} | lens))
    if expected is not None:
        assert read_matrix_camera(path).camera[4:] == expected
        return
    with pytest.raises(DataError, match="numbers of lens distortion, expected 4, 5 or 8"):
        read_matrix_camera(path)


def test_the_lens_of_a_camera_info_is_read_as_the_model_it_names(tmp_path: Path) -> None:
    path = tmp_path / "camera_info.yaml"
    text = "distortion_model: {}\nK: [600, 0, 320, 0, 600, 240, 0, 0, 1]\nD: [0.1, -0.2, 0.001, 0.002]\n"
    path.write_text(text.format("plumb_bob"))
    assert read_matrix_camera(path).camera[4:] == (0.1, -0.2, 0.001, 0.002)
    path.write_text(text.format("equidistant"))
    with pytest.raises(DataError, match="model equidistant"):
        read_matrix_camera(path)


def test_a_camera_without_its_middle_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    path.write_text(json.dumps({"fx": 50, "fy": 51}))
    with pytest.raises(DataError, match="expected fx fy cx cy or a matrix K"):
        read_matrix_camera(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [("50 51 31.5", "found 3 numbers"), ("0 0 0 0", "expected fx fy cx cy"), ("50 nan 3 2", "expected fx")],
)
def test_a_file_that_holds_no_camera(text: str, message: str, tmp_path: Path) -> None:
    make_folders(tmp_path)
    (tmp_path / "cam_K.txt").write_text(text)
    with pytest.raises(DataError, match=message):
        read(tmp_path)


def test_a_camera_for_images_of_another_size_is_refused(tmp_path: Path) -> None:
    make_folders(tmp_path)
    (tmp_path / "cam_K.txt").unlink()
    content = {"width": 128, "height": 96, "K": (2 * K).tolist()}
    (tmp_path / "camera.json").write_text(json.dumps(content))
    with pytest.raises(DataError, match="is for images of 128 x 96 px"):
        read(tmp_path)


def test_camera_txt_says_the_unit_beside_another_file_with_the_camera(tmp_path: Path) -> None:
    make_folders(tmp_path)
    (tmp_path / "camera.txt").write_text("50 51 31.5 23.5\nmetres_per_unit 0.0005\n")
    assert read(tmp_path).scene.metres_per_unit == 0.0005
    (tmp_path / "camera.txt").write_text("75 76 31.5 23.5\n")
    with pytest.raises(
        DataError, match=r"cam_K.txt says .* = 50 51 .*camera.txt says 75 76 .*correct or delete"
    ):
        read(tmp_path)


def test_without_a_camera_it_says_where_to_write_one(tmp_path: Path) -> None:
    make_folders(tmp_path)
    (tmp_path / "cam_K.txt").unlink()
    with pytest.raises(DataError, match="cam_K.txt, or give `camera"):
        read(tmp_path)
    assert read(tmp_path, camera=LENS).scene.intrinsics.fx == 50


def test_scannet(tmp_path: Path) -> None:
    """Depth of its own size and camera, and -inf where the tracker was lost."""
    for number in range(6):
        write_color(tmp_path / f"color/{number}.jpg", number)
        (tmp_path / "depth").mkdir(exist_ok=True)
        cv2.imwrite(str(tmp_path / f"depth/{number}.png"), np.full((24, 32), 700 + number, np.uint16))
        (tmp_path / "pose").mkdir(exist_ok=True)
        np.savetxt(
            tmp_path / f"pose/{number}.txt", poses(6)[number] if number != 2 else np.full((4, 4), -np.inf)
        )
    (tmp_path / "intrinsic").mkdir()
    for kind, matrix in (("color", K), ("depth", np.diag([0.5, 0.5, 1]) @ K)):
        four = np.eye(4)
        four[:3, :3] = matrix
        np.savetxt(tmp_path / f"intrinsic/intrinsic_{kind}.txt", four)
    found = read(tmp_path)
    assert [frame.index for frame in found.scene.frames] == [0, 1, 3, 4, 5]
    assert "1 frame without a valid pose (the tracker was lost there): 2" in found.skipped
    assert found.trajectory is not None
    np.testing.assert_allclose(found.trajectory.at(5), poses(6)[5], atol=1e-9)
    depth_m = read_depth_m(found.scene, found.scene.frame(4))
    assert depth_m.shape == (48, 64) and depth_m[24, 32] == pytest.approx(0.704)
    assert any("depth has 32 x 24 px, colour 64 x 48" in note for note in found.notes)


def test_depth_of_another_shape_is_refused(tmp_path: Path) -> None:
    make_folders(tmp_path)
    for number in range(6):
        cv2.imwrite(str(tmp_path / f"depth/{number:06d}.png"), np.full((64, 48), 700, np.uint16))
    with pytest.raises(DataError, match="48 x 64 px and colour of 64 x 48 px do not show the same view"):
        read(tmp_path)


def write_npy(path: Path, number: int) -> None:
    depth = depth_image(number).astype(np.float32) / 1000
    depth[1, 1], depth[1, 2] = np.nan, np.inf
    np.save(path, depth)


def write_millimetres(path: Path, number: int) -> None:
    np.save(path, depth_image(number).astype(np.float64)[None])


def write_tiff(path: Path, number: int) -> None:
    cv2.imwrite(str(path), depth_image(number).astype(np.float32) / 1000)


def write_packed(path: Path, number: int) -> None:
    units = np.rint(depth_image(number) / 1000 / 0.00012498664727900177).astype(np.uint16)
    cv2.imwrite(str(path), np.stack([0 * units, units >> 8, units & 255], axis=-1).astype(np.uint8))


@pytest.mark.parametrize(
    ("suffix", "write"),
    [("npy", write_npy), ("npy", write_millimetres), ("tiff", write_tiff), ("png", write_packed)],
)
def test_depth_in_other_files(suffix: str, write: Callable[[Path, int], None], tmp_path: Path) -> None:
    make_folders(tmp_path / "a")
    for number in range(6):
        (tmp_path / f"a/depth/{number:06d}.png").unlink()
        write(tmp_path / f"a/depth/{number:06d}.{suffix}", number)
    (tmp_path / f"a/depth/000004.{suffix}").write_bytes(b"")
    found = read(tmp_path / "a")
    assert [frame.index for frame in found.scene.frames] == [0, 1, 2, 3, 5]
    depth_m = read_depth_m(found.scene, found.scene.frame(3))
    truth = depth_image(3) / 1000
    truth[1, 1:3] = depth_m[1, 1:3]
    np.testing.assert_allclose(depth_m, truth, atol=1.3e-4)
    if write is write_npy:
        assert not depth_m[1, 1:3].any()
    assert found.scene.frames[0].depth == tmp_path / "unpacked/a/depth/000000.png"


def test_a_picture_of_depth_is_refused(tmp_path: Path) -> None:
    make_folders(tmp_path)
    for number in range(6):
        cv2.imwrite(str(tmp_path / f"depth/{number:06d}.png"), color_image(number + 1))
    with pytest.raises(DataError, match="a picture of depth"):
        read(tmp_path)


@pytest.mark.parametrize("width", [12, 16, 4])
def test_poses_in_one_file(width: int, tmp_path: Path) -> None:
    make_folders(tmp_path)
    rows = poses(6)[:, :3] if width == 12 else poses(6)
    np.savetxt(tmp_path / "poses.txt", rows.reshape(-1, width))
    found = read(tmp_path)
    assert found.trajectory is not None
    np.testing.assert_allclose(found.trajectory.scene_from_camera, poses(6), atol=1e-9)


def test_poses_in_one_file_are_in_the_order_of_all_colour_images(tmp_path: Path) -> None:
    make_folders(tmp_path)
    np.savetxt(tmp_path / "poses.txt", poses(6).reshape(-1, 16))
    (tmp_path / "depth/000001.png").unlink()
    cut(tmp_path / "rgb/000003.png")
    found = read(tmp_path)
    assert found.trajectory is not None and found.trajectory.frames.tolist() == [0, 2, 4, 5]
    np.testing.assert_allclose(found.trajectory.at(4), poses(6)[4], atol=1e-9)


def test_colours_are_read_where_they_lie(tmp_path: Path) -> None:
    make_folders(tmp_path)
    frame = read(tmp_path).scene.frames[2]
    np.testing.assert_array_equal(read_color(frame), color_image(2))


@pytest.mark.parametrize(
    ("name", "said"),
    [
        (lambda row: str(1581120424100262102 + row * 10**8), "the times of rgb are nanoseconds"),
        (lambda row: f"{0.8 + row * 0.1:.6f}", "the names in rgb/ are times in seconds"),
        (lambda row: f"{1700000000.8 + row * 0.1:.1f}", "the names in rgb/ are times in seconds"),
    ],
)
def test_names_that_are_times_are_times(tmp_path: Path, name: Callable[[int], str], said: str) -> None:
    """FoundationPose's own videos are named by nanoseconds; TUM's by seconds, whose fraction starts anew."""
    for row in range(6):
        write_color(tmp_path / f"rgb/{name(row)}.png", row)
        write_depth(tmp_path / f"depth/{name(row)}.png", row)
    np.savetxt(tmp_path / "cam_K.txt", K)
    found = read(tmp_path)
    assert any(said in note for note in found.notes)
    assert [frame.index for frame in found.scene.frames] == list(range(6))
    assert [frame.color.stem for frame in found.scene.frames] == [name(row) for row in range(6)]
    np.testing.assert_allclose(np.diff([frame.timestamp_s for frame in found.scene.frames]), 0.1, atol=1e-5)


def test_long_numbers_with_zeros_before_them_are_no_times(tmp_path: Path) -> None:
    make_folders(tmp_path, "rgb/{:010d}.png", "depth/{:010d}.png")
    assert [frame.index for frame in read(tmp_path).scene.frames] == list(range(6))


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("intrinsics.txt", "400 400 31.5 23.5"),
        ("camera.txt", "400 400 31.5 23.5"),
        ("../camera.txt", "400 400 31.5 23.5"),
    ],
)
def test_two_files_that_tell_of_different_cameras_are_refused(tmp_path: Path, file: str, text: str) -> None:
    make_folders(tmp_path / "a")
    (tmp_path / "a" / file).write_text(text)
    with pytest.raises(DataError, match="says fx fy cx cy = 50 51 31.5 23.5, but .* says 400 400"):
        read(tmp_path / "a")
    assert read(tmp_path / "a", camera=LENS).scene.intrinsics.fx == 50


def test_the_depth_unit_of_camera_txt_holds_beside_another_file_with_k(tmp_path: Path) -> None:
    make_folders(tmp_path)
    (tmp_path / "camera.txt").write_text("50 51 31.5 23.5\nmetres_per_unit 0.0005\n")
    scene = read(tmp_path).scene
    assert read_depth_m(scene, scene.frames[3])[0, 0] == pytest.approx(0.3515)


OPENCV_YAML = """camera_matrix: !!opencv-matrix
  rows: 3
  cols: 3
  dt: d
  data: [50, 0, 31.5, 0, 51, 23.5, 0, 0, 1]
"""


@pytest.mark.parametrize(
    ("file", "text", "distortion"),
    [
        ("intrinsics.txt", "50 51 31.5 23.5 0.1 0.05 0.001 0.002 0.02", (0.1, 0.05, 0.001, 0.002, 0.02)),
        ("intrinsics.txt", "50 51 31.5 23.5 0 0 0 0", ()),
        ("calib.txt", "fx: 50\ncx: 31.5\nfy: 51\ncy: 23.5\n", ()),
        ("K.txt", "K1 = [50, 0, 31.5; 0, 51, 23.5; 0, 0, 1]", ()),
        ("camera_info.yaml", OPENCV_YAML, ()),
        ("camera.yaml", "%YAML:1.0\n---\n" + OPENCV_YAML, ()),
    ],
)
def test_a_camera_as_its_file_words_it(
    tmp_path: Path, file: str, text: str, distortion: tuple[float, ...]
) -> None:
    make_folders(tmp_path)
    (tmp_path / "cam_K.txt").unlink()
    (tmp_path / file).write_text(text)
    camera = read(tmp_path).scene.intrinsics
    assert (camera.fx, camera.fy, camera.cx, camera.cy, camera.distortion) == (*LENS, distortion)


@pytest.mark.parametrize("text", ["50 0 31.5 0 51 23.5 0 1 0", "50 51 31.5 23.5 300 1 1 1", "a: [b"])
def test_numbers_that_are_neither_camera_nor_matrix_are_refused(tmp_path: Path, text: str) -> None:
    make_folders(tmp_path)
    (tmp_path / "cam_K.txt").unlink()
    (tmp_path / ("K.txt" if text[0] == "5" else "camera.yaml")).write_text(text)
    with pytest.raises(DataError, match="expected fx fy cx cy|is not valid YAML"):
        read(tmp_path)


@pytest.mark.parametrize(
    ("color", "depth"),
    [
        ("RGB", "Depth"),
        ("color_images", "depth_images"),
        ("imgs", "depth_maps"),
        ("left", "aligned_depth_to_color"),
        ("frames", "depth_frames"),
    ],
)
def test_folders_of_other_names(tmp_path: Path, color: str, depth: str) -> None:
    (tmp_path / "a/image_masks").mkdir(parents=True)
    (tmp_path / "a/depth_confidence").mkdir()
    make_folders(tmp_path / "a", f"{color}/{{}}.png", f"{depth}/{{}}.png")
    assert len(read(tmp_path / "a").scene.frames) == 6


def test_scenes_named_by_such_words_are_not_a_scene_together(tmp_path: Path) -> None:
    for scene in ("left_table", "depth_test"):
        for kind in ("rgb", "depth"):
            (tmp_path / scene / kind).mkdir(parents=True)
            (tmp_path / scene / kind / "000000.png").touch()
    assert is_folder_scene(tmp_path / "left_table") and not is_folder_scene(tmp_path)
