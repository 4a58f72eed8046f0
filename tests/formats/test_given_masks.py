"""Masks of other programs: numbers, folders, COCO; matched to frames by name."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from rpl_data.formats.masks.given import open_masks
from rpl_data.formats.masks.ids import read_ids
from rpl_data.types import DataError, Frame, Intrinsics, Scene

SIZE = (40, 60)
IDS = np.zeros(SIZE, np.uint8)
IDS[5:15, 10:30] = 1
IDS[20:35, 40:50] = 2
DAVIS = [0, 0, 0, 128, 0, 0, 0, 128, 0, 128, 128, 0]
"""Colours of the first four numbers in the palette of DAVIS, which SAM 2 and Cutie write."""


def scene(stems: list[str], name: str = "desk") -> Scene:
    frames = tuple(Frame(n, n / 30, Path(f"{stem}.jpg"), None) for n, stem in enumerate(stems))
    return Scene(name, Intrinsics(50.0, 50.0, 29.5, 19.5, SIZE[1], SIZE[0]), 0.001, frames)


def with_palette(path: Path, *, bits: int | None = None, padded: bool = False) -> None:
    """By another writer, as SAM 2 and Cutie use it."""
    image = Image.fromarray(IDS, mode="P")
    image.putpalette(DAVIS + [0] * (768 - len(DAVIS)) if padded else DAVIS)
    image.save(path, **({} if bits is None else {"bits": bits}))


@pytest.mark.parametrize("bits", [2, 4, 8])
@pytest.mark.parametrize("padded", [False, True])
def test_a_palette_gives_its_index(tmp_path: Path, bits: int, padded: bool) -> None:
    with_palette(tmp_path / "0.png", bits=bits, padded=padded)
    np.testing.assert_array_equal(read_ids(tmp_path / "0.png", size=SIZE), IDS)


def test_grey_gives_its_value(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "8.png"), IDS * 100)
    cv2.imwrite(str(tmp_path / "16.png"), IDS.astype(np.uint16) * 1000)
    Image.fromarray(IDS > 0).save(tmp_path / "1.png")  # one bit per pixel
    np.testing.assert_array_equal(read_ids(tmp_path / "8.png", size=SIZE), IDS * 100)
    np.testing.assert_array_equal(read_ids(tmp_path / "16.png", size=SIZE), IDS.astype(np.uint16) * 1000)
    np.testing.assert_array_equal(read_ids(tmp_path / "1.png", size=SIZE), IDS > 0)


def test_soft_edges_are_cut_at_the_half_and_equal_channels_are_one(tmp_path: Path) -> None:
    soft = cv2.GaussianBlur((IDS == 1).astype(np.uint8) * 255, (5, 5), 0)
    cv2.imwrite(str(tmp_path / "soft.png"), soft)
    assert len(np.unique(soft)) > 5
    np.testing.assert_array_equal(read_ids(tmp_path / "soft.png", size=SIZE), np.where(soft >= 128, 255, 0))
    several = np.repeat(np.arange(40, dtype=np.uint8), 60).reshape(SIZE)  # 39 objects, one per row
    cv2.imwrite(str(tmp_path / "many.png"), np.repeat(several[::4], 4, axis=0))
    assert len(np.unique(read_ids(tmp_path / "many.png", size=SIZE))) == 10
    cv2.imwrite(str(tmp_path / "rgb.png"), np.dstack([IDS] * 3))
    cv2.imwrite(str(tmp_path / "rgba.png"), np.dstack([IDS] * 3 + [np.full_like(IDS, 255)]))
    for name in ("rgb", "rgba"):
        np.testing.assert_array_equal(read_ids(tmp_path / f"{name}.png", size=SIZE), IDS)


def small(path: Path) -> None:
    cv2.imwrite(str(path), IDS[::2, ::2])


def turned(path: Path) -> None:
    cv2.imwrite(str(path), IDS.T)


def coloured(path: Path) -> None:
    cv2.imwrite(str(path), np.dstack([IDS, IDS, IDS + 1]))


def fading(path: Path) -> None:
    cv2.imwrite(str(path), np.add.outer(np.arange(SIZE[0]), 3 * np.arange(SIZE[1])).astype(np.uint8))


def jpeg(path: Path) -> None:
    Image.fromarray(IDS).save(path, format="JPEG")


def cut_off(path: Path) -> None:
    with_palette(path)
    path.write_bytes(path.read_bytes()[:-40])


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (small, "30 x 20 px; expected those of the colour images, 60 x 40"),
        (turned, "as if it were turned"),
        (coloured, "holds colours"),
        (fading, r"grey levels that fade into one another, so they are no object numbers"),
        (jpeg, "is no PNG image"),
        (cut_off, "is damaged"),
    ],
)
def test_what_are_no_masks_is_said(tmp_path: Path, damage: Callable[[Path], None], said: str) -> None:
    damage(tmp_path / "000000.png")
    masks = open_masks(tmp_path, "png", scene(["000000"]))
    with pytest.raises(DataError, match=said):
        masks.at(0)


def test_frames_are_matched_by_name_never_by_row(tmp_path: Path) -> None:
    for stem in ("000004", "000002", "000009"):
        with_palette(tmp_path / f"{stem}.png")
    masks = open_masks(tmp_path, "png", scene(["000001", "000002", "000003", "000004"]))
    assert sorted(masks.readers) == [1, 3]
    assert masks.notes == ("2 frames of 4 have no given mask", "1 given mask left out: named like no frame")
    assert masks.at(0) is None
    found = masks.at(1)
    assert found is not None and sorted(found) == ["1", "2"]
    np.testing.assert_array_equal(found["2"], IDS == 2)


def test_numbers_of_another_width_match(tmp_path: Path) -> None:
    with_palette(tmp_path / "0000012.png")  # as Cutie writes a video's frames
    assert sorted(open_masks(tmp_path, "png", scene(["00011", "00012"])).readers) == [1]


def test_names_that_fit_no_frame_are_refused(tmp_path: Path) -> None:
    with_palette(tmp_path / "00000.png")
    with pytest.raises(DataError, match=r"expected names such as 1305031102\.1, found 00000"):
        open_masks(tmp_path, "png", scene(["1305031102.1"]))
    with pytest.raises(DataError, match="does not exist"):
        open_masks(tmp_path / "nowhere", "png", scene(["0"]))


def test_one_folder_for_several_scenes_is_refused(tmp_path: Path) -> None:
    with_palette(tmp_path / "000000.png")  # of which scene?
    with pytest.raises(DataError, match="expected a folder per scene in it, such as .*desk"):
        open_masks(tmp_path, "png", scene(["000000"]), alone=False)


def test_a_folder_per_object_in_a_folder_per_scene(tmp_path: Path) -> None:
    for key in (1, 2):
        path = tmp_path / f"desk/{key:03d}/00000.png"  # SAM 2 with --per_obj_png_file
        path.parent.mkdir(parents=True)
        cv2.imwrite(str(path), 255 * np.equal(IDS, key).astype(np.uint8))
    found = open_masks(tmp_path, "folders", scene(["00000"])).at(0)
    assert found is not None and sorted(found) == ["001", "002"]
    np.testing.assert_array_equal(found["002"], IDS == 2)


def coco_file(path: Path, **changes: object) -> Path:
    """A rectangle as a polygon and another as run lengths, in an image of the scene `desk`."""
    runs = np.flatnonzero(np.diff(np.concatenate([[0], (IDS == 2).T.ravel(), [0]])))
    lengths = np.diff(np.concatenate([[0], runs, [IDS.size]])).tolist()
    annotations = [
        {"id": 1, "image_id": 7, "category_id": 3, "segmentation": [[10, 5, 30, 5, 30, 15, 10, 15]]},
        {"id": 2, "image_id": 7, "category_id": 4, "segmentation": {"size": [40, 60], "counts": lengths}},
    ]
    image = {"id": 7, "file_name": "desk/000005.jpg", "width": 60, "height": 40}
    other = {**image, "id": 8, "file_name": "shelf/000005.jpg"}
    categories = [{"id": 3, "name": "cup"}, {"id": 4, "name": "drill"}]
    data = {"images": [image | changes, other], "annotations": annotations, "categories": categories}
    path.write_text(json.dumps(data))
    return path


def test_coco_has_polygons_and_run_lengths(tmp_path: Path) -> None:
    masks = open_masks(coco_file(tmp_path / "all.json"), "coco", scene(["000005"]), alone=False)
    found = masks.at(0)
    assert found is not None
    np.testing.assert_array_equal(found["cup"], IDS == 1)
    np.testing.assert_array_equal(found["drill"], IDS == 2)


def test_coco_of_another_size_is_refused(tmp_path: Path) -> None:
    file = coco_file(tmp_path / "all.json", width=61)
    masks = open_masks(file, "coco", scene(["000005"]), alone=False)
    with pytest.raises(DataError, match="61 x 40 px; expected 60 x 40"):
        masks.at(0)


@pytest.mark.parametrize("first", [0, 2])
def test_masks_counted_from_another_number_are_refused(tmp_path: Path, first: int) -> None:
    """As many masks as frames, one off: by their names, all but one would fit."""
    for number in range(first, first + 4):
        with_palette(tmp_path / f"{number:05d}.png")
    with pytest.raises(DataError, match="0000[02] to 0000[35] where the frames have 00001 to 00004"):
        open_masks(tmp_path, "png", scene(["00001", "00002", "00003", "00004"]))


def coco_images(path: Path, images: list[dict[str, object]]) -> Path:
    """A file in which the mask of image n is n columns wide."""
    for number, image in enumerate(images, start=1):
        image |= {"id": number, "height": SIZE[0], "width": SIZE[1]}
    masks = [
        {"id": n, "image_id": n, "category_id": 1, "segmentation": [[0, 0, n, 0, n, 9, 0, 9]]}
        for n in range(1, len(images) + 1)
    ]
    categories = [{"id": 1, "name": "cup"}]
    path.write_text(json.dumps({"images": images, "annotations": masks, "categories": categories}))
    return path


def test_coco_of_several_scenes_gives_this_one_its_own(tmp_path: Path) -> None:
    names = [f"images/{folder}/000001.png" for folder in ("shelf", "desk", "floor")]
    file = coco_images(tmp_path / "m.json", [{"file_name": name} for name in names])
    masks = open_masks(file, "coco", scene(["000001"])).at(0)
    assert masks is not None and masks["cup"].any(axis=0).sum() == 2
    with pytest.raises(DataError, match="two images are called 000001"):
        open_masks(file, "coco", scene(["000001"], name="sofa"))


def test_coco_of_our_own_exports_says_the_frame(tmp_path: Path) -> None:
    """They call images by frame, which here is one less than what the recording calls them."""
    images = [{"file_name": f"images/desk/{n:06d}.png", "scene": "desk", "frame": n} for n in (0, 1)]
    file = coco_images(tmp_path / "m.json", [dict(image) for image in images])
    found = open_masks(file, "coco", scene(["000001", "000002"]))
    assert [found.readers[n]()["cup"].any(axis=0).sum() for n in (0, 1)] == [1, 2]
