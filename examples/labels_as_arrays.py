"""The labels of a workspace as NumPy arrays: poses, keypoints, boxes, with their frame numbers.

    python examples/labels_as_arrays.py my-workspace

Here: how far the camera was from each object, and where it stood in the object's own frame.
"""

import sys

import numpy as np

from rpl_data import Workspace


def main(folder: str) -> None:
    """Print a line per object."""
    workspace = Workspace(folder)
    print(workspace)
    for name in workspace.object_names():
        labels = workspace.label_arrays(name)  # all scenes; scene="00" for one
        object_from_camera = np.linalg.inv(labels.camera_from_object)  # (n, 4, 4), metres
        distances_m = np.linalg.norm(labels.camera_from_object[:, :3, 3], axis=1)
        nearest = distances_m.argmin()
        print(
            f"{name}: {len(labels)} labels in scenes {', '.join(sorted(set(labels.scenes)))}; "
            f"{distances_m.min():.2f} to {distances_m.max():.2f} m from the camera, "
            f"nearest in frame {labels.frames[nearest]} of scene {labels.scenes[nearest]}, "
            f"camera then at {object_from_camera[nearest, :3, 3].round(3)} m in the object's frame; "
            f"{(labels.visibility == 2).mean():.0%} of its keypoints seen"
        )


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(*sys.argv[1:])
