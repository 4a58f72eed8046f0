"""A studio with one cube, each of whose faces has a colour of its own, and one plate."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from rpl_data.synthesize.body import Body
from rpl_data.synthesize.light import SceneLight
from rpl_data.synthesize.painted import PaintedMesh, grid
from rpl_data.synthesize.storage import save_studio
from rpl_data.synthesize.studio import DepthNoise, Noise, Plane, Plate, Studio, Subject
from rpl_data.synthesize.views import shown_directions
from rpl_data.types import Intrinsics

CAMERA = Intrinsics(150.0, 150.0, 79.5, 59.5, 160, 120)
HALF_M = 0.05
CORNERS = HALF_M * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
FACES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
"""-x, x, -y, y, -z, z, counter-clockwise from outside."""
COLORS = np.array(
    [[200, 60, 60], [60, 200, 60], [60, 60, 200], [200, 200, 60], [60, 200, 200], [150, 90, 60]]
)
FLAT = np.concatenate([[[1.0, 1, 1]], np.zeros((8, 3))])
UP = np.array([0.0, -1.0, 0.0])


def cube_body(*, unseen: tuple[int, ...] = (), pieces: int = 6) -> Body:
    """The cube, its faces cut into pieces; those faces were not seen."""
    vertices, triangles, colors, seen = [], [], [], []
    for number, face in enumerate(FACES):
        a, b, _, d = CORNERS[face]
        steps = np.linspace(0, 1, pieces + 1)
        start = len(vertices)
        vertices += [a + u * (b - a) + v * (d - a) for u in steps for v in steps]
        for i in range(pieces):
            for j in range(pieces):
                p, q = start + i * (pieces + 1) + j, start + (i + 1) * (pieces + 1) + j
                triangles += [[p, q, q + 1], [p, q + 1, p + 1]]
        colors += [COLORS[number]] * (2 * pieces**2)
        seen += [number not in unseen] * (2 * pieces**2)
    texels = np.repeat(np.array(colors, np.uint8)[:, None], len(grid(2)), axis=1)
    painted = PaintedMesh(np.array(vertices), np.array(triangles, np.int64), texels, np.array(seen))
    return Body("cube", painted, CORNERS.copy())


def cube_studio(folder: Path, *, keypoints: tuple[str, ...] = tuple("abcdefgh")) -> Studio:
    """The studio, also saved to the folder; the plate shows a grey table from above at 45 degrees."""
    folder.mkdir(parents=True)
    plate = np.full((CAMERA.height, CAMERA.width, 3), 90, np.uint8)
    cv2.imwrite(str(folder / "plate.png"), plate)
    normal = np.array([0.0, -1.0, -1.0]) / np.sqrt(2)
    body = replace(cube_body(), points_object=np.resize(CORNERS, (len(keypoints), 3)))
    subject = Subject(
        body=body,
        keypoints=keypoints,
        views=np.array([[0.0, 0, 1]]),
        shown=shown_directions(body),
        ups=np.array([[0.0, 0, 1]]),
        turn_deg=180.0,
        nearest_m=0.4,
        farthest_m=0.6,
        keypoint_sigma_m=0.001,
        lights={"00": SceneLight(UP, FLAT)},
    )
    studio = Studio(
        scenes=("00", "01"),
        subjects={"cube": subject},
        plates=(Plate("00", 3, folder / "plate.png", None, None, CAMERA, normal, Plane(normal, -0.4)),),
        noise=Noise(0.0, {"cube": DepthNoise()}),
        together=(1,),
        centres=np.array([[0.5, 0.5]]),
    )
    save_studio(folder, studio, {"scenes": ["00", "01"]})
    return studio
