"""Make the studio of a workspace: what new views are rendered from, of its training scenes alone."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from rpl_data.directions import view_direction
from rpl_data.export.folder import replacing
from rpl_data.formats.datasets.coco import CocoObject, depth_unit_m, intrinsics_from_coco, visible_mask
from rpl_data.geometry import Transform, invert
from rpl_data.images import read_pixels
from rpl_data.json_arrays import Json, matrix_from_json
from rpl_data.pipeline.context import Context
from rpl_data.pipeline.ledger import stamps
from rpl_data.pipeline.synthesis.models import can_be_made, scene_table, training_mesh
from rpl_data.pipeline.synthesis.plates import Table, make_plates
from rpl_data.pipeline.synthesis.training import Training
from rpl_data.raycast import PixelTable
from rpl_data.synthesize.body import Body
from rpl_data.synthesize.light import SceneLight
from rpl_data.synthesize.measure import color_noise, depth_errors, depth_noise
from rpl_data.synthesize.paint import Photo, paint
from rpl_data.synthesize.render import Placed, alone
from rpl_data.synthesize.storage import load_studio, save_studio, studio_made_of
from rpl_data.synthesize.studio import DepthNoise, Noise, Studio, Subject
from rpl_data.synthesize.views import shown_directions
from rpl_data.torch.turns import turn_by_places, up_in_object
from rpl_data.types import DataError, Intrinsics, spread_evenly
from rpl_data.types.instances import scene_of
from rpl_data.workspace.parts import Parts
from rpl_data.workspace.workspace import Workspace

VERSION = 5
"""Increase it when the same workspace gives another studio."""
MOST_PHOTOS = 80
"""Images per object that colour it."""
LEAST_SEEN = 0.5
"""Visible share of an object below which an image does not colour it."""
MEASURED_EVERY = 8
"""One in so many of these images is compared with the model, for the noise of depth."""

Tell = Callable[[str], None]

PartOf = Callable[[Json], str]
"""From an image of the export to the part of its recording that it is in."""


@dataclass
class _Gathered:
    """What is collected from object to object."""

    color_noise: list[float] = field(default_factory=list)
    depth_errors: dict[str, list[DepthNoise]] = field(default_factory=dict)
    tables: dict[Intrinsics, PixelTable] = field(default_factory=dict)

    def table(self, camera: Intrinsics) -> PixelTable:
        """The rays of a camera, computed once."""
        if camera not in self.tables:
            self.tables[camera] = PixelTable.of(camera)
        return self.tables[camera]


def studio_of(context: Context, training: Training, *, again: bool, tell: Tell) -> Studio:
    """Load the workspace's studio, or make it where it is not up to date.

    Raises:
        DataError: an object has no dense model of the training scenes, or an image is missing.
    """
    folder = context.workspace.studio
    made_of = _made_of(context, training)
    if not again and studio_made_of(folder) == made_of:
        return load_studio(folder)
    with replacing(folder) as building:
        save_studio(building, _make(context, training, building, tell), made_of)
    return load_studio(folder)


def _made_of(context: Context, training: Training) -> Json:
    """What the studio depends on, all of it of training scenes."""
    workspace, parts = context.workspace, context.workspace.parts()
    scenes = [one for one in workspace.scene_names() if parts.video_of(one) in training.scenes]
    surfaces = {one: stamps(workspace.surface_file(one)) for one in scenes}
    poses = {}
    for item in training.objects:
        solution = workspace.load_placed(item.model.name)
        placed = {place: pose.round(9).tolist() for place, pose in solution.scene_from_object.items()}
        poses[item.model.name] = [[p, placed[p]] for p in sorted(placed) if scene_of(p) in scenes]
    return {
        "version": VERSION,
        "scenes": list(training.scenes),
        "labels": training.digest,
        "surfaces": surfaces,
        "poses": hashlib.sha256(str(poses).encode()).hexdigest()[:16],
    }


def _make(context: Context, training: Training, folder: Path, tell: Tell) -> Studio:
    workspace, parts = context.workspace, context.workspace.parts()
    tell("tables of the training scenes")
    tables = _tables(workspace, parts, training.scenes)

    def part_of(image: Json) -> str:
        return parts.scene_at(image["scene"], image["frame"])

    gathered, shown = _Gathered(), training.names()
    used = sorted({part_of(image) for image in training.data["images"]})
    ups = {part: _up(training, part, part_of, tables[part]) for part in used}
    subjects = {
        item.model.name: _subject(context, training, item, part_of, tables, ups, gathered, tell)
        for item in training.objects
        if item.model.name in shown and can_be_made(context, item.model.name, training.scenes)
    }
    tell("backgrounds: tables without their objects")
    plates = make_plates(folder, training, part_of, tables, ups)
    per_image = Counter(one["image_id"] for one in training.data["annotations"])
    return Studio(
        scenes=training.scenes,
        subjects=subjects,
        plates=plates,
        noise=Noise(float(np.median(gathered.color_noise or [0.0])), depth_noise(gathered.depth_errors)),
        together=tuple(sorted(per_image.values())),
        centres=_centres(training),
    )


def _tables(workspace: Workspace, parts: Parts, videos: Sequence[str]) -> dict[str, Table | None]:
    """The table of each part of these recordings; where it is not known there, that of another part."""
    found = {
        scene: scene_table(workspace, scene)
        for scene in workspace.scene_names()
        if parts.video_of(scene) in videos
    }
    known: dict[str, Table] = {}
    for part, table in found.items():
        if table is not None:
            known.setdefault(parts.video_of(part), table)
    return {part: table or known.get(parts.video_of(part)) for part, table in found.items()}


def _centres(training: Training) -> np.ndarray:
    images = {image["id"]: image for image in training.data["images"]}
    rows = []
    for one in training.data["annotations"]:
        (x, y, width, height), image = one["bbox"], images[one["image_id"]]
        rows.append([(x + width / 2) / image["width"], (y + height / 2) / image["height"]])
    return np.array(rows, dtype=float).reshape(-1, 2)


def _up(training: Training, part: str, part_of: PartOf, table: Table | None) -> np.ndarray:
    """What is up in a part of a recording: out of its table, else what is up in its images, on average."""
    if table is not None:
        return table[0]
    poses = [
        matrix_from_json(image["scene_from_camera"])
        for image in training.data["images"]
        if part_of(image) == part
    ]
    # Seen from the scene, as `up_in_object` sees it from an object.
    return up_in_object(np.array([invert(pose) for pose in poses]))


def _subject(
    context: Context,
    training: Training,
    item: CocoObject,
    part_of: PartOf,
    tables: Mapping[str, Table | None],
    ups: Mapping[str, np.ndarray],
    gathered: _Gathered,
    tell: Tell,
) -> Subject:
    name = item.model.name
    tell(f"{name}: dense model of the training scenes")
    mesh, seen = training_mesh(context, item, training.scenes)
    labels = training.labels(name)
    tell(f"{name}: colours and light")
    painted, lights = paint(mesh, seen, _photos(training.folder, labels, gathered))
    body = Body(name, painted, item.model.points_object)
    _measure(training.folder, labels, body, gathered)
    poses = np.array([matrix_from_json(one["camera_from_object"]) for _, one in labels])
    # Where the object stands: a part of a recording is too short to tell which way is up in its images alone.
    standing = np.array([f"{image['scene']}/{one.get('instance', '')}" for image, one in labels])
    places = np.array([f"{part_of(image)}/{one.get('instance', '')}" for image, one in labels])
    up_by_light = {image["scene"]: ups[part_of(image)] for image, _ in reversed(labels)}
    distances = np.linalg.norm(poses[:, :3, 3], axis=1)
    return Subject(
        body=body,
        keypoints=item.model.keypoints,
        views=np.array([view_direction(pose) for pose in poses]),
        shown=shown_directions(body),
        ups=np.array(
            [_up_of(labels, poses, places == place, part_of, tables) for place in np.unique(places)]
        ),
        turn_deg=turn_by_places(standing, poses),
        nearest_m=float(np.percentile(distances, 2)),
        farthest_m=float(np.percentile(distances, 98)),
        keypoint_sigma_m=_keypoint_sigma_m(context, name),
        lights={scene: SceneLight(up_by_light[scene], light) for scene, light in sorted(lights.items())},
        symmetries=item.symmetries,
        carved=seen is None,
    )


def _up_of(
    labels: list[tuple[Json, Json]],
    poses: np.ndarray,
    chosen: np.ndarray,
    part_of: PartOf,
    tables: Mapping[str, Table | None],
) -> np.ndarray:
    """What is up for one instance of the object in a part of a recording, object frame."""
    first = int(np.flatnonzero(chosen)[0])
    image, _ = labels[first]
    table = tables[part_of(image)]
    if table is None:
        return up_in_object(poses[chosen])
    up: np.ndarray = (matrix_from_json(image["scene_from_camera"]) @ poses[first])[:3, :3].T @ table[0]
    return up


def _keypoint_sigma_m(context: Context, name: str) -> float:
    """How well the shape of the sparse model is known, standard deviation per axis."""
    covariance = context.workspace.load_placed(name).covariance
    return float(np.sqrt(np.nanmean(np.trace(covariance, axis1=1, axis2=2)) / 3))


def _chosen(labels: list[tuple[Json, Json]]) -> list[tuple[Json, Json]]:
    """Images in which the object is seen well, spread over all of them."""
    good = [(image, one) for image, one in labels if one["visib_fract"] >= LEAST_SEEN] or labels
    return spread_evenly(good, MOST_PHOTOS)


def _photos(folder: Path, labels: list[tuple[Json, Json]], gathered: _Gathered) -> Iterator[Photo]:
    for image, one in _chosen(labels):
        color = read_pixels(folder / image["file_name"])
        if color is None:
            raise DataError(
                f"cannot read {folder / image['file_name']}: it is missing or damaged; export again"
            )
        gathered.color_noise.append(color_noise(color))
        yield Photo(
            image["scene"],
            gathered.table(intrinsics_from_coco(image)),
            matrix_from_json(image["scene_from_camera"]),
            matrix_from_json(one["camera_from_object"]),
            color,
            visible_mask(one),
        )


def _measure(folder: Path, labels: list[tuple[Json, Json]], body: Body, gathered: _Gathered) -> None:
    """Compare the model with recorded depth in some of the images."""
    measured = gathered.depth_errors.setdefault(body.name, [])
    for image, one in _chosen(labels)[::MEASURED_EVERY]:
        if image["depth_file_name"] is None:
            continue
        units = cv2.imread(str(folder / image["depth_file_name"]), cv2.IMREAD_UNCHANGED)
        pose: Transform = matrix_from_json(one["camera_from_object"])
        found = alone(gathered.table(intrinsics_from_coco(image)), Placed(body, pose))
        if units is None or found is None:
            continue
        measured_m = units[found.window].astype(np.float32) * np.float32(depth_unit_m(image))
        errors = depth_errors(found.depth_m, visible_mask(one)[found.window], measured_m)
        if errors is not None:
            measured.append(errors)
