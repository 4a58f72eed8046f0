"""Make the pictures of the page "Section by section" from a built workspace of the demo.

    python docs/pictures.py workspaces/demo

Each shows what a stage takes or makes: clicks on a frame, the surfaces of two scenes, the dense model from
three sides with its keypoints, labels.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from rpl_data import Workspace
from rpl_data.geometry import invert, project, rigid, transform
from rpl_data.images import read_color
from rpl_data.meshes import load_mesh
from rpl_data.overlay import keypoint_color
from rpl_data.raycast import RayScene, pixel_rays, rays_in_object
from rpl_data.types import Intrinsics, Mesh

HERE = Path(__file__).parent
GROUND = (245, 245, 245)


def main(folder: str) -> None:
    """Write docs/method_*.jpg."""
    workspace = Workspace(folder)
    save("method_clicks.jpg", beside([clicks_on(workspace, "carton", scene) for scene in ("00", "01")]))
    save("method_surfaces.jpg", beside([surface_of(workspace, scene) for scene in ("00", "01")]))
    save("method_models.jpg", beside([model_seen(workspace, "carton", turn) for turn in (0, 120, 240)]))
    save("method_labels.jpg", beside([workspace.overlay("00", 40), workspace.overlay("01", 40)]))


def clicks_on(workspace: Workspace, name: str, scene: str) -> np.ndarray:
    """The frame of a scene with most clicks on an object, and these clicks as crosses."""
    clicks = [c for c in workspace.load_annotation(name).clicks if c.scene == scene]
    frame = max({c.frame for c in clicks}, key=[c.frame for c in clicks].count)
    picture = read_color(workspace.load_scene(scene).frame(frame)).copy()
    for click in (c for c in clicks if c.frame == frame):
        colour = keypoint_color(click.keypoint, len(workspace.model(name).keypoints))
        at = (round(click.u_px), round(click.v_px))
        cv2.drawMarker(picture, at, (20, 20, 20), cv2.MARKER_CROSS, 22, 5, cv2.LINE_AA)
        cv2.drawMarker(picture, at, colour, cv2.MARKER_CROSS, 20, 2, cv2.LINE_AA)
    return picture


def surface_of(workspace: Workspace, name: str) -> np.ndarray:
    """The surface of a scene, seen by the camera of its first frame."""
    scene = workspace.load_scene(name)
    scene_from_camera = workspace.load_trajectory(scene).at(scene.frames[0].index)
    return rendered(load_mesh(workspace.surface_file(name)), scene.intrinsics, invert(scene_from_camera))


def model_seen(workspace: Workspace, name: str, turn_deg: float) -> np.ndarray:
    """The dense model with its keypoints, from a side."""
    camera_from_object = workspace.label_arrays(name, scene="00").camera_from_object[0].copy()
    camera_from_object[:3, 3] = 0.0, 0.0, 0.3
    turned = camera_from_object @ rigid(cv2.Rodrigues(np.deg2rad([0.0, turn_deg, 0.0]))[0], np.zeros(3))
    lens = replace(workspace.load_scene("00").intrinsics, cx=319.5, cy=239.5, distortion=())
    picture = rendered(workspace.mesh(name), lens, turned)
    points = transform(turned, workspace.model(name).points_object)
    for number, (u, v) in enumerate(project(lens, points)):
        cv2.circle(picture, (round(u), round(v)), 6, keypoint_color(number, len(points)), -1, cv2.LINE_AA)
    return picture


def rendered(mesh: Mesh, lens: Intrinsics, camera_from_mesh: np.ndarray) -> np.ndarray:
    """A mesh in its own colours, a little darker where it turns away from the camera."""
    directions = pixel_rays(lens, left_px=0, top_px=0, width=lens.width, height=lens.height)
    rays = rays_in_object(directions, camera_from_mesh)
    hits = RayScene([mesh]).cast(rays)
    hit = hits.triangle_id >= 0
    colors = np.full((len(hit), 3), GROUND, dtype=float)
    corners = mesh.triangles[hits.triangle_id[hit]]
    inner = np.column_stack([1 - hits.uv[hit].sum(axis=1), hits.uv[hit]])
    vertex_colors = np.full_like(mesh.vertices, 180) if mesh.colors is None else mesh.colors
    towards = -rays[hit, 3:] / np.linalg.norm(rays[hit, 3:], axis=1, keepdims=True)
    facing = np.abs((towards * hits.normals[hit]).sum(axis=1))
    colors[hit] = np.einsum("nk,nkc->nc", inner, vertex_colors[corners]) * (0.55 + 0.45 * facing[:, None])
    return colors.clip(0, 255).reshape(lens.height, lens.width, 3).astype(np.uint8)


def beside(pictures: list[np.ndarray]) -> np.ndarray:
    """Pictures side by side, 1200 px wide together."""
    wide = np.hstack(pictures)
    return cv2.resize(wide, (1200, round(1200 * wide.shape[0] / wide.shape[1])), interpolation=cv2.INTER_AREA)


def save(name: str, picture: np.ndarray) -> None:
    """Write a picture beside the pages."""
    cv2.imwrite(str(HERE / name), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 82])
    print(HERE / name)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(sys.argv[1])
