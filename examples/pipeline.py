"""From a recording and clicks to labels, with the library's own functions, one step per section of the paper.

    python examples/pipeline.py my-recording my-recording/clicks.csv cube my-workspace

`rpl build` does the same and more: it keeps what is up to date, tracks cameras, splits and exports. Copy this
where a stage of your own should take the place of one of ours: what one stage returns, the next one takes.
"""

import csv
import sys
from pathlib import Path

from rpl_data import Workspace, open_recordings
from rpl_data.clicks.lift import lift_clicks
from rpl_data.clicks.table import clicks_from_csv
from rpl_data.geometry import sphere_around, transform
from rpl_data.images import depth_reader, read_color
from rpl_data.label.alone import SceneObject
from rpl_data.label.label import label_frames
from rpl_data.meshes import save_mesh
from rpl_data.reconstruct.surface import fuse_surface
from rpl_data.segment.segment import segment_object
from rpl_data.solve.solve import solve


def main(recording: str, clicks_csv: str, name: str, out: str) -> None:
    """Label every frame of a recording that comes with camera poses."""
    recordings = {one.scene.name: one for one in open_recordings(recording)}
    scenes = {scene: one.scene for scene, one in recordings.items()}
    trajectories = {scene: one.trajectory for scene, one in recordings.items()}

    # Section III-B: the clicks, and the depth under them.
    text = Path(clicks_csv).read_text(encoding="utf-8")
    rows = [row for row in csv.DictReader(text.splitlines()) if row["object"] == name]
    keypoints = list(dict.fromkeys(row["keypoint"] for row in rows))
    clicks = clicks_from_csv(text, source=clicks_csv, object_name=name, keypoints=keypoints)
    observations = lift_clicks(clicks, scenes, trajectories, depth_reader)

    # Section III-C: the sparse model and where it stands in each scene (Eq. 2).
    solution = solve(name, keypoints, observations)

    # Section III-D: the surface around the object in each scene, and the dense model they agree on.
    surfaces = {}
    for scene, scene_from_object in solution.scene_from_object.items():
        points_object = solution.model.points_object[solution.model.known]
        around = sphere_around(transform(scene_from_object, points_object))
        surfaces[scene] = fuse_surface(
            scenes[scene], trajectories[scene], scenes[scene].frames, depth_reader(scenes[scene]),
            centre_scene=around.centre_m, radius_m=around.radius_m, colors=read_color,
        )  # fmt: skip
    dense = segment_object(surfaces, solution)

    # Section III-E: keypoints, boxes and masks of every frame (Eq. 3).
    workspace = Workspace(out)
    workspace.save_solution(solution)
    save_mesh(workspace.mesh_file(name), dense.mesh)
    for scene, scene_from_object in solution.scene_from_object.items():
        body = SceneObject(solution.model, solution.covariance, dense.mesh, scene_from_object)
        workspace.save_recording(recordings[scene])
        labels = label_frames(
            scenes[scene], trajectories[scene], [body], scenes[scene].frames, depth_reader(scenes[scene])
        )
        workspace.save_labels(scene, labels)
    print(workspace)


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit(__doc__)
    main(*sys.argv[1:])
