"""Every labelled frame as a picture with its masks, boxes and keypoints drawn on it.

python examples/draw_labels.py my-workspace pictures
"""

import sys
from pathlib import Path

import cv2

from rpl_data import Workspace


def main(folder: str, out: str) -> None:
    """Write one JPEG per labelled frame."""
    workspace = Workspace(folder)
    for scene in workspace.labelled_scene_names():
        (Path(out) / scene).mkdir(parents=True, exist_ok=True)
        for label in workspace.labels(scene):
            picture = workspace.overlay(scene, label.frame)  # RGB; OpenCV writes BGR
            cv2.imwrite(str(Path(out) / scene / f"{label.frame:06d}.jpg"), picture[..., ::-1])
        print(f"{Path(out) / scene}: {len(workspace.labels(scene))} pictures")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(*sys.argv[1:])
