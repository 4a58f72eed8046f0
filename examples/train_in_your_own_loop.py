"""Your own network and training loop on our Dataset: keypoint heatmaps, and the pose that follows from them.

    python examples/train_in_your_own_loop.py my-workspace/export/coco cube

The network is a toy, so that the script is quick to read and to run; put yours in its place. The paper's
hourglass and a complete trainer are in `training/`.
"""

import sys

import torch
from torch import nn
from torch.utils.data import DataLoader

from rpl_data.torch import (
    Augmentation,
    Intrinsics,
    KeypointDataset,
    PoseEstimate,
    correspondences,
    estimate_pose,
    locate,
    positions_in_image,
)

SIZES = {"input_px": 128, "heatmap_px": 32}


def network(keypoints: int) -> nn.Module:
    """Crops of 128 px -> one heatmap of 32 px per keypoint."""
    layers: list[nn.Module] = []
    for before, after, stride in [(3, 16, 2), (16, 32, 2), (32, 32, 1), (32, 32, 1)]:
        layers += [nn.Conv2d(before, after, 5, stride, padding=2), nn.BatchNorm2d(after), nn.ReLU()]
    return nn.Sequential(*layers, nn.Conv2d(32, keypoints, 1))


def main(export: str, name: str, epochs: int = 3) -> None:
    """Train, then print the pose of the first validation image beside its label."""
    train = KeypointDataset(export, split="train", object=name, augment=Augmentation(), cache=True, **SIZES)
    val = KeypointDataset(export, split="val", object=name, **SIZES)
    torch.manual_seed(0)
    model = network(len(train.model.keypoints))
    optimizer = torch.optim.Adam(model.parameters(), lr=1e-3)
    for epoch in range(int(epochs)):
        for batch in DataLoader(train, batch_size=8, shuffle=True):
            error = (model(batch["image"]) - batch["heatmaps"]) ** 2  # (batch, k, 32, 32)
            # A keypoint weighs 0 where it has no label, or is not in the crop.
            loss = (error.mean(dim=(2, 3)) * batch["weights"]).mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        print(f"epoch {epoch + 1}: loss {loss.item():.5f}")

    sample = val[0]
    with torch.no_grad():
        found = locate(model.eval()(sample["image"][None]), sigma_px=1.0)  # pixels of the heatmap
    keypoints_px = positions_in_image(found.positions, sample["crop_from_image"][None], **SIZES)[0].numpy()
    (fx, _, cx), (_, fy, cy), _ = sample["camera_matrix"].tolist()
    camera = Intrinsics(fx, fy, cx, cy, width=0, height=0, distortion=tuple(sample["distortion"].tolist()))
    pose = estimate_pose(correspondences(val.model.points_object, keypoints_px, camera), method="epnp")
    if isinstance(pose, PoseEstimate):
        print("predicted camera_from_object, metres:", pose.camera_from_object.round(3), sep="\n")
    else:
        print(f"no pose: {pose.reason}; train for longer")
    print("labelled camera_from_object, metres:", sample["camera_from_object"].numpy().round(3), sep="\n")


if __name__ == "__main__":
    if len(sys.argv) not in (3, 4):
        sys.exit(__doc__)
    main(*sys.argv[1:])
