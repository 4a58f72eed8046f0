"""Heatmaps: drawn at sub-pixel positions, decoded, and taken back to the image."""

import numpy as np
import pytest
import torch

from rpl_data.torch.decoding import locate
from rpl_data.torch.heatmaps import draw_heatmaps, positions_in_image
from rpl_data.torch.transforms import chained, crop_from_square, heatmap_from_crop, moved


def naive_heatmaps(positions_px, size_px, sigma_px):
    """The per-keypoint loop: the definition."""
    maps = np.zeros((len(positions_px), size_px, size_px))
    for k, (u, v) in enumerate(positions_px):
        for row in range(size_px):
            for column in range(size_px):
                maps[k, row, column] = np.exp(-((column - u) ** 2 + (row - v) ** 2) / (2 * sigma_px**2))
    return maps


def test_equals_the_definition():
    positions = np.array([[3.25, 7.5], [0.0, 15.0], [12.4, 1.1]])
    drawn = draw_heatmaps(torch.from_numpy(positions), size_px=16, sigma_px=1.3).numpy()
    np.testing.assert_allclose(drawn, naive_heatmaps(positions, 16, 1.3), atol=1e-6)
    assert drawn.dtype == np.float32
    assert drawn[1, 15, 0] == 1.0  # (u, v) = (column, row)


def test_a_batch_is_its_members():
    positions = torch.rand(3, 4, 2, dtype=torch.float64) * 20
    batch = draw_heatmaps(positions, size_px=20)
    assert batch.shape == (3, 4, 20, 20)
    torch.testing.assert_close(batch[1], draw_heatmaps(positions[1], size_px=20))


def test_missing_keypoint_gives_zeros_and_no_nan():
    drawn = draw_heatmaps(torch.tensor([[torch.nan, torch.nan], [4.0, 4.0]]), size_px=8)
    assert drawn[0].abs().sum() == 0 and drawn[1].max() == 1


def test_edges_coincide_not_centres():
    affine = heatmap_from_crop(input_px=256, heatmap_px=64)
    np.testing.assert_allclose(moved(affine, np.array([-0.5, 255.5])), [-0.5, 63.5])
    np.testing.assert_allclose(moved(affine, np.array([1.5, 1.5])), [0, 0])  # middle of the first 4 x 4


@pytest.mark.parametrize(("input_px", "heatmap_px"), [(256, 64), (192, 48), (128, 64), (100, 33)])
def test_round_trip_to_the_image(input_px, heatmap_px):
    rng = np.random.default_rng(1)
    centre, side = np.array([310.3, 201.7]), 173.9
    crop_from_image = crop_from_square(centre, side, input_px=input_px, rotation_rad=0.4)
    uv = centre + rng.uniform(-0.3, 0.3, (50, 2)) * side
    on_map = moved(chained(heatmap_from_crop(input_px=input_px, heatmap_px=heatmap_px), crop_from_image), uv)
    maps = draw_heatmaps(torch.from_numpy(on_map)[None], size_px=heatmap_px)
    decoded = locate(maps, sigma_px=1.0).positions
    back = positions_in_image(
        decoded, torch.from_numpy(crop_from_image)[None], input_px=input_px, heatmap_px=heatmap_px
    )
    assert np.abs(back[0].numpy() - uv).max() < 0.01
