"""Networks that start from weights: torchvision's bodies behind heatmaps, files, checkpoints of ours."""

from __future__ import annotations

from pathlib import Path
from urllib.error import URLError

import pytest
import torch
from torchvision.models import resnet18

from rpl_data.types import DataError
from training.keypoints.networks import network_of, start_of
from training.runs import weights
from training.runs.options import Network
from training.runs.weights import start_from

RESNET = Network(features=16, input_px=64, heatmap_px=16, architecture="resnet18")
HOURGLASS = Network(stacks=1, features=16, levels=2, input_px=32, heatmap_px=8)


def test_a_body_of_torchvision_is_taken_whole_and_finds_keypoints(tmp_path: Path) -> None:
    torch.save(resnet18(weights=None).state_dict(), tmp_path / "resnet.pth")
    network = network_of(5, RESNET).eval()
    said = start_from(start_of(network, RESNET), str(tmp_path / "resnet.pth"))
    given = torch.load(tmp_path / "resnet.pth", weights_only=True)
    taken = network.get_submodule("body").state_dict()
    assert all(torch.equal(value, given[key]) for key, value in taken.items())
    assert f"{len(taken)} tensors taken" in said and len(given) == len(taken) + 2  # without its classes
    with torch.no_grad():
        (heatmaps,) = network(torch.rand(2, 3, 64, 64))
    assert heatmaps.shape == (2, 5, 16, 16)


def test_convnext_has_the_same_head() -> None:
    options = Network(features=8, input_px=32, heatmap_px=8, architecture="convnext_tiny")
    with torch.device("meta"):  # shapes alone: its random weights take seconds
        network = network_of(3, options).eval()
        assert network(torch.rand(1, 3, 32, 32))[0].shape == (1, 3, 8, 8)


def test_a_checkpoint_of_another_object_leaves_its_heads_behind(tmp_path: Path) -> None:
    trained, network = network_of(7, HOURGLASS), network_of(4, HOURGLASS)
    state = {f"network.{key}": value for key, value in trained.state_dict().items()}
    torch.save({"state_dict": state}, tmp_path / "last.ckpt")
    said = start_from(start_of(network, HOURGLASS), str(tmp_path / "last.ckpt"))
    assert " 2 stay random" in said  # weight and bias of the one head
    key = "stem.0.weight"
    assert torch.equal(network.state_dict()[key], trained.state_dict()[key])
    wider = Network(stacks=1, features=32, levels=2, input_px=32, heatmap_px=8)
    with pytest.raises(DataError, match=r"does not hold the network hourglass: \d+ of its \d+ tensors"):
        start_from(start_of(network_of(4, wider), wider), str(tmp_path / "last.ckpt"))


def test_what_cannot_be_fetched_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    class Unreachable:
        class DEFAULT:
            @staticmethod
            def get_state_dict(check_hash: bool) -> None:
                raise URLError("no route to host")

    monkeypatch.setattr(weights, "get_model_weights", lambda name: Unreachable)
    with pytest.raises(DataError, match="cannot fetch .* of resnet18: .*no route.*; give the path of a file"):
        start_from(start_of(network_of(1, RESNET), RESNET), "imagenet")
    with pytest.raises(DataError, match="no ImageNet weights of the network hourglass"):
        start_from(start_of(network_of(1, HOURGLASS), HOURGLASS), "imagenet")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (Network(input_px=48, heatmap_px=12, architecture="resnet18"), "halves it five times"),
        (Network(input_px=64, heatmap_px=32, architecture="resnet18"), "a quarter as wide"),
    ],
)
def test_sizes_that_do_not_go_together(options: Network, said: str) -> None:
    with pytest.raises(DataError, match=said):
        network_of(1, options)
