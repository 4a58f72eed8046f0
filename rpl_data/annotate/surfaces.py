"""Points around an object in a scene for the 3D view, from the first click on, before any build.

Points come from the scene's fused surface if a build has made one, else from the depth of a few frames.
They stay in the scene frame: the page moves them by the result of every click, which shows at once
whether the scenes coincide.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float64, UInt8

from rpl_data.annotate.session import Result
from rpl_data.annotate.stores.scenes import PosedScene, SceneStore
from rpl_data.geometry import Points, Sphere, back_project, sphere_around, transform
from rpl_data.images import read_color
from rpl_data.json_arrays import Json
from rpl_data.meshes import load_mesh, simplified
from rpl_data.types import DataError, DepthImage
from rpl_data.types.instances import scene_of
from rpl_data.workspace.workspace import Workspace

MOST_POINTS = 5000
"""Points per scene: enough to see whether two surfaces coincide, few enough for a slow link."""
MOST_TRIANGLES = 6000
FRAMES = 6
"""Number of frames whose depth is used without a fused surface."""
STRIDE_PX = 3
"""Every third pixel in both directions is used."""
SCENES_KEPT = 8
"""Number of scenes whose points are cached."""


@dataclass(frozen=True)
class Coloured:
    """Points with RGB colours, scene frame, metres."""

    points: Float64[np.ndarray, "n 3"]
    colors: UInt8[np.ndarray, "n 3"]


class SurfaceStore:
    """Points of scenes; the most recently used are cached."""

    def __init__(self, scenes: SceneStore) -> None:
        self.scenes = scenes
        self._fused = lru_cache(SCENES_KEPT)(self._read_fused)
        self._seen = lru_cache(SCENES_KEPT)(self._read_frames)

    def near(self, scene: str, ball: Sphere, frames: Sequence[int]) -> Coloured:
        """Return at most `MOST_POINTS` points in the ball.

        Args:
            frames: frames whose depth is used if the scene has no fused surface there yet.
        """
        found = _inside(self._fused(scene, self._stamp(scene)), ball)
        if len(found.points) < 300:  # no fused surface yet, or one around another object
            found = _inside(self._seen(scene, tuple(frames)[:FRAMES]), ball)
        return thinned(found)

    def _stamp(self, scene: str) -> int:
        path = self.scenes.workspace.surface_file(scene_of(scene))
        return path.stat().st_mtime_ns if path.exists() else 0

    def _read_fused(self, scene: str, stamp: int) -> Coloured:
        if not stamp:
            return Coloured(np.empty((0, 3)), np.empty((0, 3), np.uint8))
        mesh = load_mesh(self.scenes.workspace.surface_file(scene_of(scene)))
        grey = np.full((len(mesh.vertices), 3), 150, np.uint8)
        return Coloured(mesh.vertices, grey if mesh.colors is None else mesh.colors)

    def _read_frames(self, scene: str, frames: tuple[int, ...]) -> Coloured:
        posed = self.scenes.get(scene)
        seen = [_seen(posed, frame, self.scenes.depth_m(scene, frame)) for frame in frames]
        return Coloured(
            np.concatenate([np.empty((0, 3)), *(part.points for part in seen)]),
            np.concatenate([np.empty((0, 3), np.uint8), *(part.colors for part in seen)]),
        )


def _seen(posed: PosedScene, frame: int, depth_m: DepthImage) -> Coloured:
    """Points of every third pixel in every third row that has depth, in the scene frame."""
    v, u = np.mgrid[0 : depth_m.shape[0] : STRIDE_PX, 0 : depth_m.shape[1] : STRIDE_PX].reshape(2, -1)
    measured = depth_m[v, u] > 0
    u, v = u[measured], v[measured]
    uv = np.column_stack([u, v]).astype(float)
    points = back_project(posed.scene.intrinsics, uv, depth_m[v, u].astype(float))
    return Coloured(
        transform(posed.trajectory.at(frame), points), read_color(posed.frame(frame))[v, u].astype(np.uint8)
    )


def _inside(cloud: Coloured, ball: Sphere) -> Coloured:
    chosen = np.linalg.norm(cloud.points - ball.centre_m, axis=1) < ball.radius_m
    return Coloured(cloud.points[chosen], cloud.colors[chosen])


def thinned(cloud: Coloured, *, most: int = MOST_POINTS) -> Coloured:
    """Reduce to one point per voxel, with the smallest voxel that gives at most `most` points."""
    size_m = 0.003
    while len(cloud.points) > most:
        cells = np.floor(cloud.points / size_m).astype(np.int64)
        first = np.unique(cells, axis=0, return_index=True)[1]
        cloud = Coloured(cloud.points[first], cloud.colors[first])
        size_m *= 1.3
    return cloud


def surroundings(result: Result, scene: str) -> Sphere | None:
    """Ball around the object if its pose is known, else around its lifted clicks; None without either."""
    solution = result.live.solution
    if solution is not None and scene in solution.scene_from_object:
        model = solution.model
        points: Points = transform(solution.scene_from_object[scene], model.points_object[model.known])
        return sphere_around(points)
    lifted = [point for click, point in result.lifted if click.scene == scene]
    return sphere_around(np.array(lifted), factor=2.0, margin_m=0.12) if lifted else None


def surface_payload(cloud: Coloured) -> Json:
    """Encode points as float32 and colours as bytes, base64."""
    return {"points": packed(cloud.points, "<f4"), "colors": packed(cloud.colors, "u1")}


def dense_payload(workspace: Workspace, object_name: str) -> Json | None:
    """Encode the dense model of the last build, with few triangles; None when there is none.

    It is in the object frame of the build that made it; `scene_from_object` of one scene of that build
    lets the page move it to the frame of the current clicks.
    """
    path = workspace.mesh_file(object_name)
    if not path.exists() or not workspace.solution_file(object_name).exists():
        return None
    scene_from_object = workspace.load_placed(object_name).scene_from_object
    if not scene_from_object:
        raise DataError(f"the solution of {object_name} places it in no scene; run the solve stage again")
    mesh = simplified(load_mesh(path), most_triangles=MOST_TRIANGLES)
    return {
        "places": {name: [float(x) for x in matrix.ravel()] for name, matrix in scene_from_object.items()},
        "points": packed(mesh.vertices, "<f4"),
        "colors": None if mesh.colors is None else packed(mesh.colors, "u1"),
        "triangles": packed(mesh.triangles, "<u2"),
    }


def packed(values: np.ndarray, kind: str) -> str:
    """Encode an array's bytes as base64."""
    return base64.b64encode(np.ascontiguousarray(values, dtype=kind).tobytes()).decode("ascii")
