"""KeypointDataset: what a sample holds, where its pixels come from, workers and caches."""

import pickle
from multiprocessing.reduction import ForkingPickler
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch
from labelled_scenes import BOX, CAMERA, CAN, exported, smooth_image
from torch.utils.data import DataLoader

from rpl_data.formats.datasets.coco import read_coco
from rpl_data.geometry import project, transform
from rpl_data.torch.colours import jittered
from rpl_data.torch.decoding import locate
from rpl_data.torch.detection import DetectionDataset
from rpl_data.torch.device import widest_float
from rpl_data.torch.heatmaps import positions_in_image
from rpl_data.torch.image_files import read_image
from rpl_data.torch.instances import InstanceDataset
from rpl_data.torch.keypoints import KeypointDataset, KeypointSample
from rpl_data.torch.pixel_cache import rectangle_around
from rpl_data.torch.transforms import (
    Augmentation,
    chained,
    crop_from_square,
    inverted,
    moved,
    random_crop_from_square,
    reach,
    warped,
)
from rpl_data.types import DataError

GEOMETRIC = Augmentation(gain=0.0, offset=0.0)


@pytest.fixture(scope="module")
def coco(tmp_path_factory):
    return exported(tmp_path_factory.mktemp("keypoints")) / "train.json"


def test_sample_has_every_field(coco):
    dataset = KeypointDataset(coco, object="box")
    sample = dataset[0]
    assert set(sample) == set(KeypointSample.__annotations__)
    assert len(dataset) == 5
    shapes = {
        "image": (3, 256, 256),
        "heatmaps": (4, 64, 64),
        "weights": (4,),
        "keypoints_px": (4, 2),
        "visibility": (4,),
        "crop_from_image": (2, 3),
        "camera_matrix": (3, 3),
        "distortion": (14,),
        "camera_from_object": (4, 4),
        "points_object": (4, 3),
        "square_box": (3,),
    }
    assert {key: tuple(sample[key].shape) for key in shapes} == shapes
    assert sample["image"].dtype == torch.float32 and 0 <= sample["image"].min() <= sample["image"].max() <= 1
    # Seen and hidden keypoints weigh 1; the one never clicked weighs 0 and has no position.
    assert sample["visibility"].tolist() == [1, 2, 2, 0] and sample["weights"].tolist() == [1, 1, 1, 0]
    assert sample["keypoints_px"][3].isnan().all() and sample["points_object"][3].isnan().all()
    assert sample["heatmaps"][3].sum() == 0 and (sample["heatmaps"][:3].amax(dim=(1, 2)) > 0.7).all()


def test_sample_leads_back_to_the_pose(coco):
    sample = KeypointDataset(coco, object="box", augment=GEOMETRIC)[2]
    points = transform(sample["camera_from_object"].numpy(), sample["points_object"].numpy()[:3])
    np.testing.assert_allclose(project(CAMERA, points), sample["keypoints_px"][:3], atol=1e-3)
    np.testing.assert_allclose(sample["camera_matrix"], CAMERA.matrix)
    assert sample["distortion"][:4].tolist() == list(CAMERA.distortion)
    # OpenCV takes matrix and coefficients as they are and finds the pose.
    many = np.tile(points, (2, 1)) + np.repeat([[0, 0, 0], [0, 0, 0.1]], 3, axis=0)
    uv, _ = cv2.projectPoints(many, np.zeros(3), np.zeros(3), CAMERA.matrix, sample["distortion"].numpy())
    np.testing.assert_allclose(uv[:3, 0], sample["keypoints_px"][:3], atol=1e-3)


@pytest.mark.parametrize("augment", [None, GEOMETRIC])
@pytest.mark.parametrize(("input_px", "heatmap_px"), [(256, 64), (192, 48)])
def test_heatmaps_lead_back_to_the_image(coco, augment, input_px, heatmap_px):
    torch.manual_seed(0)
    dataset = KeypointDataset(coco, object="box", input_px=input_px, heatmap_px=heatmap_px, augment=augment)
    for sample in dataset:
        positions = locate(sample["heatmaps"], sigma_px=1.0).positions
        back = positions_in_image(
            positions, sample["crop_from_image"], input_px=input_px, heatmap_px=heatmap_px
        )
        inside = sample["weights"] == 1
        assert inside.any()
        assert (back - sample["keypoints_px"])[inside].abs().max() < 0.01


def test_pixels_lie_where_the_matrix_says(coco):
    torch.manual_seed(1)
    for row, sample in enumerate(KeypointDataset(coco, object="box", augment=GEOMETRIC)):
        image = cv2.cvtColor(smooth_image(row + 1), cv2.COLOR_BGR2RGB).astype(np.float32) / 255
        uv = np.array([[60.0, 50.0], [45.0, 60.0], [50.0, 70.0]])
        on_crop = moved(sample["crop_from_image"].numpy(), uv)
        inside = ((on_crop > 1) & (on_crop < 254)).all(axis=1)
        assert inside.any()
        for (u, v), (cu, cv) in zip(uv[inside].astype(int), on_crop[inside], strict=True):
            patch = cv2.getRectSubPix(sample["image"].permute(1, 2, 0).numpy(), (1, 1), (cu, cv))
            assert np.abs(patch[0, 0] - image[v, u]).max() < 0.02


def test_keypoint_outside_the_crop_weighs_nothing(coco):
    torch.manual_seed(2)
    samples = [
        s for _ in range(4) for s in KeypointDataset(coco, object="box", augment=Augmentation(shift=0.6))
    ]
    weights = torch.stack([s["weights"][:3] for s in samples])
    assert 0 < weights.mean() < 1
    for sample in samples:
        on_crop = moved(sample["crop_from_image"].numpy(), sample["keypoints_px"].numpy()[:3])
        inside = ((on_crop >= -0.5) & (on_crop < 255.5)).all(axis=1)
        assert sample["weights"][:3].tolist() == inside.astype(float).tolist()
        assert (sample["heatmaps"][:3].amax(dim=(1, 2)) > 0).tolist() == inside.tolist()


def test_square_box_fills_the_crop(coco):
    sample = KeypointDataset(coco, object="can")[0]
    cx, cy, side = sample["square_box"].tolist()
    corners = np.array([[cx - side / 2, cy - side / 2], [cx + side / 2, cy + side / 2]])
    np.testing.assert_allclose(moved(sample["crop_from_image"].numpy(), corners), [[-0.5] * 2, [255.5] * 2])
    annotation = read_coco(coco)["annotations"][1]
    assert sample["square_box"].tolist() == annotation["square_box"]
    assert sample["annotation_id"] == annotation["id"] and sample["image_id"] == annotation["image_id"]


@pytest.mark.parametrize("augment", [None, Augmentation()])
def test_cache_changes_nothing(coco, tmp_path, augment):
    batches = []
    for cache in (False, True, tmp_path / "cache", tmp_path / "cache"):
        torch.manual_seed(3)
        batches.append(list(KeypointDataset(coco, object="box", augment=augment, cache=cache)))
    assert len(list((tmp_path / "cache").iterdir())) == 1  # found again, not written again
    for other in batches[1:]:
        for a, b in zip(batches[0], other, strict=True):
            torch.testing.assert_close(a["image"], b["image"], rtol=0, atol=1.5 / 255)
            torch.testing.assert_close(a["heatmaps"], b["heatmaps"], rtol=0, atol=0)


@pytest.mark.parametrize("cache", [False, True])
def test_workers_agree_with_the_main_process(coco, cache):
    dataset = KeypointDataset(coco, object="box", cache=cache)
    here = next(iter(DataLoader(dataset, batch_size=5)))
    there = next(iter(DataLoader(dataset, batch_size=5, num_workers=2)))
    assert set(here) == set(there)
    for key in here:
        torch.testing.assert_close(here[key], there[key], equal_nan=True)


def test_workers_draw_different_numbers_and_seeds_repeat(coco):
    dataset = KeypointDataset(coco, object="box", augment=Augmentation())

    def drawn(seed):
        torch.manual_seed(seed)
        loader = DataLoader(dataset, batch_size=1, num_workers=2)
        return torch.cat([batch["crop_from_image"] for batch in loader])

    first = drawn(0)
    assert torch.equal(first, drawn(0)) and not torch.equal(first, drawn(1))
    turns = torch.atan2(first[:, 1, 0], first[:, 0, 0])
    assert len({round(float(turn), 6) for turn in turns}) == len(turns)


def test_shown_at_a_prompt(coco):
    text = "5 instances of box, 4 keypoints, crops of 128 px, heatmaps of 64 px"
    shown = repr(KeypointDataset(coco, object="box", input_px=128))
    assert str(coco) in shown and shown.endswith(text)


def test_messages(coco, tmp_path):
    with pytest.raises(DataError, match="choose one of box, can"):
        KeypointDataset(coco)
    with pytest.raises(DataError, match="no object 'cup'"):
        KeypointDataset(coco, object="cup")
    with pytest.raises(IndexError):
        KeypointDataset(coco, object="box")[5]
    folder = exported(tmp_path, models=(BOX,), frames=1)
    with pytest.raises(DataError, match="no instance of box"):
        KeypointDataset(folder / "train.json")


def test_missing_image_is_named(tmp_path):
    folder = exported(tmp_path, models=(CAN,), frames=2)
    dataset = KeypointDataset(folder / "train.json")
    (folder / "images" / "desk" / "000001.png").unlink()
    with pytest.raises(DataError, match=r"000001\.png"):
        dataset[0]


# Transforms ---------------------------------------------------------------------------------------


def test_an_image_of_another_size_than_its_labels_is_refused(tmp_path):
    """Crops would be cut elsewhere; with half the size, everything still lies within the image."""
    coco = exported(tmp_path)
    image = coco / read_coco(coco / "train.json")["images"][1]["file_name"]
    small = cv2.resize(cv2.imread(str(image)), (80, 60))
    image.unlink()
    cv2.imwrite(str(image), small)
    crops = [KeypointDataset(coco, split="train", object="box", cache=cache) for cache in (False, True)]
    for dataset, row in [
        *((dataset, 0) for dataset in crops),
        (DetectionDataset(coco, split="train"), 1),
        (InstanceDataset(coco, split="train"), 1),
    ]:
        with pytest.raises(DataError, match=f"{image.name} is 80 x 60 px, its labels are for 160 x 120 px"):
            dataset[row]
    with pytest.raises(DataError, match="80 x 60 px"):
        KeypointDataset(coco, split="train", object="box", cache=tmp_path / "cache")


def test_halved_images_are_as_large_as_stated_to_the_last_row(tmp_path):
    cv2.imwrite(str(tmp_path / "odd.jpg"), np.zeros((21, 33, 3), np.uint8))
    for halved in (False, True):
        read_image(str(tmp_path / "odd.jpg"), halved=halved, size=(33, 21))
        with pytest.raises(DataError, match="its labels are for 37 x 21 px"):
            read_image(str(tmp_path / "odd.jpg"), halved=halved, size=(37, 21))


def test_never_mirrored_and_within_the_amounts():
    rng = np.random.default_rng(0)
    augmentation = Augmentation(scale=0.2, shift=0.1, rotation_deg=20.0)
    centre, side = np.array([100.0, 80.0]), 60.0
    for _ in range(200):
        affine = random_crop_from_square(centre, side, augmentation, rng, input_px=128)
        zoom = np.sqrt(np.linalg.det(affine[:, :2]))  # a mirror image would have a negative determinant
        assert 128 / (60 * 1.2) <= zoom <= 128 / (60 * 0.8)
        assert abs(np.degrees(np.arctan2(affine[1, 0], affine[0, 0]))) <= 20
        back = moved(inverted(affine), np.array([63.5, 63.5]))
        assert np.abs(back - centre).max() <= 6 + 1e-9


def test_reach_holds_every_crop():
    rng = np.random.default_rng(0)
    augmentation = Augmentation(scale=0.3, shift=0.2, rotation_deg=80.0)
    corners = np.array([[-0.5, -0.5], [63.5, -0.5], [-0.5, 63.5], [63.5, 63.5]])
    half = reach(augmentation) * 40
    seen = max(
        np.abs(moved(inverted(affine), corners) - [300, 300]).max()
        for affine in (
            random_crop_from_square(np.array([300.0, 300]), 40.0, augmentation, rng, input_px=64)
            for _ in range(500)
        )
    )
    assert 0.8 * half < seen <= half


def test_inverse_and_chain():
    affine = crop_from_square(np.array([10.0, 20]), 30.0, input_px=64, rotation_rad=1.0)
    np.testing.assert_allclose(chained(affine, inverted(affine)), np.eye(3)[:2], atol=1e-12)


def test_unmoved_crop_is_the_image():
    image = smooth_image(0)[:64, :64]
    affine = crop_from_square(np.array([31.5, 31.5]), 64.0, input_px=64)
    np.testing.assert_array_equal(warped(image, affine, size=(64, 64)), image)


def test_jitter_is_a_gain_a_channel_and_an_offset():
    rng = np.random.default_rng(0)
    image = np.full((2, 2, 3), 100, dtype=np.uint8)
    seen = np.array([jittered(image, Augmentation(gain=0.2, offset=0.0), rng)[0, 0] for _ in range(100)])
    assert seen.min() >= 79 and seen.max() <= 120 and (seen.std(axis=0) > 5).all()
    np.testing.assert_array_equal(jittered(image, GEOMETRIC, rng), image)


def test_region_stays_on_the_image():
    rectangle = rectangle_around(np.array([2.0, 3.0, 10.0]), half=1.0, width=20, height=30)
    assert (rectangle.left, rectangle.top, rectangle.right, rectangle.bottom) == (0, 0, 14, 15)
    beyond = rectangle_around(np.array([-200.0, 300.0, 10.0]), half=1.0, width=20, height=30)
    assert beyond.right > beyond.left and beyond.bottom > beyond.top


# Devices and workers --------------------------------------------------------------------------------


def test_heatmaps_drawn_on_the_device_are_those_of_the_workers(coco):
    options = {"object": "box", "input_px": 192, "heatmap_px": 48, "sigma_px": 1.5}
    drawn = KeypointDataset(coco, augment=GEOMETRIC, **options)
    bare = KeypointDataset(coco, augment=GEOMETRIC, heatmaps=False, **options)
    torch.manual_seed(3)
    expected = next(iter(DataLoader(drawn, batch_size=5)))
    torch.manual_seed(3)
    batch = next(iter(DataLoader(bare, batch_size=5)))
    assert "heatmaps" not in batch
    moved_batch = bare.to_device(batch, "cpu")
    assert set(moved_batch) == set(expected)
    torch.testing.assert_close(moved_batch["heatmaps"], expected["heatmaps"], atol=1e-6, rtol=0)


def test_float64_goes_only_where_it_exists():
    assert widest_float(torch.device("cuda")) == widest_float(torch.device("cpu")) == torch.float64
    assert widest_float(torch.device("mps")) == torch.float32


def test_half_a_cache_changes_nothing(coco):
    plain = KeypointDataset(coco, object="box")
    half = KeypointDataset(coco, object="box", cache=True, cache_limit_mb=0.03)
    kept = [row in half._cache for row in range(len(half))]
    assert any(kept) and not all(kept)
    for row in (*range(len(half)), -1):
        torch.testing.assert_close(plain[row]["image"], half[row]["image"], rtol=0, atol=1.5 / 255)
    with pytest.raises(DataError, match="cache_limit_mb is 0.0; give more"):
        KeypointDataset(coco, object="box", cache=True, cache_limit_mb=0.0)


@pytest.mark.parametrize("on_disk", [False, True])
def test_spawned_workers_share_the_cache(coco, tmp_path, on_disk):
    dataset = KeypointDataset(coco, object="box", cache=tmp_path if on_disk else True)
    pixels = dataset._cache._pixels.nbytes
    before = dataset[1]["image"]
    sent = ForkingPickler.dumps(dataset)  # what a spawned worker is sent
    assert len(sent) < len(ForkingPickler.dumps(KeypointDataset(coco, object="box"))) + 2000 < pixels
    there = pickle.loads(sent)  # noqa: S301
    assert torch.equal(there[1]["image"], before) and torch.equal(dataset[1]["image"], before)


def test_a_cache_beyond_the_shared_memory_is_refused(coco, monkeypatch):
    monkeypatch.setattr("shutil.disk_usage", lambda path: SimpleNamespace(free=1000))
    dataset = KeypointDataset(coco, object="box", cache=True)
    with pytest.raises(DataError, match="shared memory.*give `cache` a folder"):
        ForkingPickler.dumps(dataset)
