"""The stacked hourglass against the published one, its losses, and what is read out of heatmaps."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from labelled_scenes import CAN, exported
from torch import nn
from torch.utils.data import default_collate

from rpl_data.torch.decoding import in_image, locate, probabilities
from rpl_data.torch.heatmaps import draw_heatmaps, positions_in_image
from rpl_data.torch.keypoints import KeypointDataset
from training.keypoints.hourglass import (
    Residual,
    StackedHourglass,
    cross_entropy,
    mean_squares,
)

# The network ----------------------------------------------------------------------------------------


def test_published_size():
    """The authors' PyTorch network of two stacks has 8.42 million parameters with 8 keypoints.

    1.86 million of them are skip convolutions of residuals that keep their width, which its forward pass
    never uses; ours has none of these.
    """
    network = StackedHourglass(8)
    unused = sum(
        width * width + width
        for width in (_width(module) for module in network.modules() if isinstance(module, Residual))
        if width
    )
    assert unused == 28 * 65_792 + 16_512
    trained = sum(parameter.numel() for parameter in network.parameters())
    assert trained == 6_564_240
    assert (trained + unused) / 1e6 == pytest.approx(8.42, abs=0.005)


def _width(residual: Residual) -> int:
    """Of a residual that keeps its width, else 0."""
    before, after = residual.body[2].in_channels, residual.body[-1].out_channels
    return before if before == after and isinstance(residual.skip, nn.Identity) else 0


def test_published_shapes():
    network = StackedHourglass(16).eval()
    with torch.no_grad():
        found = network(torch.zeros(1, 3, 256, 256))
    assert [tuple(heatmaps.shape) for heatmaps in found] == [(1, 16, 64, 64)] * 2


@pytest.mark.parametrize(("stacks", "keypoints"), [(1, 1), (3, 5)])
def test_every_stack_is_supervised(stacks, keypoints):
    network = StackedHourglass(keypoints, stacks=stacks, features=32, levels=2)
    found = network(torch.rand(2, 3, 64, 64))
    assert [tuple(heatmaps.shape) for heatmaps in found] == [(2, keypoints, 16, 16)] * stacks
    for number, heatmaps in enumerate(found):
        network.zero_grad()
        heatmaps.square().mean().backward(retain_graph=True)
        assert network.heads[number].weight.grad.abs().sum() > 0
        assert all(head.weight.grad is None for head in network.heads[number + 1 :])


# Losses -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("loss", [mean_squares, cross_entropy])
def test_gradient_obeys_the_visibility_weights(loss):
    torch.manual_seed(0)
    heatmaps = torch.randn(2, 3, 6, 6, dtype=torch.float64, requires_grad=True)
    targets = draw_heatmaps(torch.rand(2, 3, 2) * 5, size_px=6).double()
    weights = torch.tensor([[1.0, 0, 1], [0, 0, 1]], dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda maps: loss(maps, targets, weights), (heatmaps,))
    loss(heatmaps, targets, weights).backward()
    moved = heatmaps.grad.abs().sum(dim=(-1, -2))
    assert torch.equal(moved > 0, weights > 0)


def test_loss_without_any_visible_keypoint_is_zero():
    heatmaps = torch.randn(2, 3, 6, 6, requires_grad=True)
    for loss in (mean_squares, cross_entropy):
        value = loss(heatmaps, torch.zeros(2, 3, 6, 6), torch.zeros(2, 3))
        assert value == 0 and torch.isfinite(value)


def test_cross_entropy_is_least_at_the_target():
    targets = draw_heatmaps(torch.tensor([[[3.3, 7.8]]]), size_px=16)
    weights = torch.ones(1, 1)
    best = cross_entropy(targets.clamp_min(1e-9).log(), targets, weights)
    for _ in range(20):
        assert (
            cross_entropy(targets.clamp_min(1e-9).log() + torch.randn(1, 1, 16, 16), targets, weights) > best
        )


def test_sixteen_frames_are_learned_to_a_pixel(tmp_path):
    torch.manual_seed(0)
    coco = exported(tmp_path, models=(CAN,), frames=17) / "train.json"
    dataset = KeypointDataset(coco, input_px=64, heatmap_px=16)
    batch = default_collate([dataset[row] for row in range(16)])
    network = StackedHourglass(3, stacks=1, features=24, levels=2)
    optimizer = torch.optim.Adam(network.parameters(), lr=5e-3)
    for _ in range(50):
        loss = cross_entropy(network(batch["image"])[-1], batch["heatmaps"], batch["weights"])
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    with torch.no_grad():
        found = locate(probabilities(network(batch["image"])[-1], sigma_px=1.0), sigma_px=1.0)
    true = locate(batch["heatmaps"], sigma_px=1.0).positions
    off_px = (found.positions - true).norm(dim=-1) * 4  # of the input
    assert off_px.median() < 0.5 and off_px.max() < 1


# Decoding -----------------------------------------------------------------------------------------


def test_gaussians_of_any_shape_are_located_exactly():
    torch.manual_seed(1)
    positions = 8 + 16 * torch.rand(20, 3, 2)
    angle = torch.rand(20, 3) * math.pi
    turn = torch.stack([angle.cos(), -angle.sin(), angle.sin(), angle.cos()], dim=-1).reshape(20, 3, 2, 2)
    spread = turn @ torch.diag_embed(1 + 3 * torch.rand(20, 3, 2)) @ turn.transpose(-1, -2)
    found = locate(gaussians(positions, spread), sigma_px=1.0)
    assert (found.positions - positions).abs().max() < 0.02
    expected = spread - torch.eye(2)  # what the target's own Gaussian is not the reason of
    torch.testing.assert_close(found.covariance, expected, rtol=0.1, atol=0.12)


def gaussians(positions, covariance):
    """Maps of 32 x 32, 1 high."""
    grid = torch.stack(torch.meshgrid(torch.arange(32.0), torch.arange(32.0), indexing="xy"), dim=-1)
    off = grid - positions[..., None, None, :]
    return torch.exp(
        -0.5 * torch.einsum("...yxi,...ij,...yxj->...yx", off, torch.linalg.inv(covariance), off)
    )


def test_heatmaps_are_located_at_the_edge_too():
    positions = torch.tensor([[[0.2, 0.4], [31.0, 15.3], [30.6, 31.3], [12.5, 0.0]]])
    found = locate(draw_heatmaps(positions, size_px=32), sigma_px=1.0)
    assert (found.positions - positions).abs().max() < 0.6  # what lies beyond the edge is not seen
    inner = torch.tensor([[[3.5, 4.25], [20.0, 15.3]]])
    found = locate(draw_heatmaps(inner, size_px=32), sigma_px=1.0)
    assert (found.positions - inner).abs().max() < 1e-3
    torch.testing.assert_close(found.covariance, 0.09 * torch.eye(2).expand(1, 2, 2, 2), rtol=1e-3, atol=1e-3)


def test_two_places_are_uncertain():
    maps = 0.5 * draw_heatmaps(torch.tensor([[[10.0, 16.0]], [[22.0, 16.0]]]), size_px=32).sum(dim=0)
    found = locate(maps, sigma_px=1.0)
    assert found.covariance[0, 0, 0] > 30 > 0.2 > found.covariance[0, 1, 1]
    assert found.confidence[0] == pytest.approx(0.5, abs=0.01)


def test_nothing_is_finite_and_not_confident():
    found = locate(torch.zeros(2, 3, 16, 16), sigma_px=1.0)
    assert all(torch.isfinite(part).all() for part in found) and found.confidence.max() == 0


def test_probabilities_of_a_sure_network_are_as_high_as_targets():
    targets = draw_heatmaps(torch.tensor([[[7.3, 8.6]]]), size_px=16, sigma_px=1.5)
    maps = probabilities(targets.clamp_min(1e-9).log(), sigma_px=1.5)
    torch.testing.assert_close(maps, targets, atol=1e-3, rtol=1e-2)


def test_covariance_turns_with_the_crop():
    turn = np.deg2rad(30)
    linear = 0.5 * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    crop_from_image = torch.from_numpy(np.column_stack([linear, [3.0, 4.0]]))[None]
    heatmap = torch.tensor([[10.0, 10], [11, 10], [10, 11]])[None]
    sizes = {"input_px": 64, "heatmap_px": 16}
    u = positions_in_image(heatmap, crop_from_image, **sizes)[0]
    axes = torch.stack([u[1] - u[0], u[2] - u[0]], dim=-1)  # image from heatmap
    covariance = torch.tensor([[[[2.0, 0.5], [0.5, 1.0]]]])
    expected = axes @ covariance[0, 0].double() @ axes.T
    torch.testing.assert_close(in_image(covariance, crop_from_image, **sizes)[0, 0], expected)
