"""BOP's layout (the benchmark for 6D object pose), for trainers and evaluations that read it.

::

    <folder>/camera.json, dataset_info.md, test_targets_bop19.json
             models/obj_000001.ply, models_info.json          millimetres, the object frame
             {train,val,test}/000001/                         one folder per scene, see `recordings.bop`
                rgb/ depth/ mask/ mask_visib/ scene_camera.json scene_gt.json scene_gt_info.json

A scene has the same number in every split; image ids are frame numbers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float64

from rpl_data.export.dialect import DialectSummary, Split, splits_of
from rpl_data.export.folder import link, replacing
from rpl_data.files import write_bytes, write_json, write_text
from rpl_data.formats.datasets.coco import intrinsics_from_coco, objects_from_coco
from rpl_data.formats.recordings.bop import write_scene_camera, write_scene_gt
from rpl_data.json_arrays import Json, matrix_from_json
from rpl_data.meshes import load_mesh, mesh_to_ply
from rpl_data.types import Mesh


def export_bop(folder: Path, coco: Path, metres_per_unit: Mapping[str, float]) -> DialectSummary:
    """Write `folder` from an exported COCO folder; images are linked, masks are written.

    Args:
        folder: folder to write; its old content is replaced.
        coco: the exported COCO folder.
        metres_per_unit: unit of the depth images, by scene name.

    Raises:
        DataError: the COCO folder is missing or broken, a lens has distortion, which the layout cannot hold,
            or the folder cannot be written.
    """
    numbers = {name: number for number, name in enumerate(sorted(metres_per_unit), start=1)}
    images: dict[str, int] = {}
    instances, without_mesh, cameras, targets = 0, [], [], []
    with replacing(folder) as building:
        for split in splits_of(coco):
            images[split.name] = len(split.images)
            for scene in sorted({image["scene"] for image in split.images}):
                mine = [image for image in split.images if image["scene"] == scene]
                scene_folder = building / split.name / f"{numbers[scene]:06d}"
                instances += _write_scene(scene_folder, coco, mine, split, metres_per_unit[scene])
                targets += _targets(numbers[scene], mine, split) if split.name == "test" else []
                cameras.append(_camera(mine[0], metres_per_unit[scene]))
            without_mesh = _write_models(building / "models", coco, split.data)
        write_json(building / "camera.json", cameras[0])
        if targets:
            write_json(building / "test_targets_bop19.json", targets)
        write_text(building / "dataset_info.md", _info(numbers))
    lines = [f"{name} has no dense model, so no models/*.ply" for name in without_mesh]
    return DialectSummary(images, instances, tuple(lines))


def _camera(image: Json, metres_per_unit: float) -> Json:
    lens = intrinsics_from_coco(image)
    return {
        "cx": lens.cx, "cy": lens.cy, "fx": lens.fx, "fy": lens.fy,
        "width": lens.width, "height": lens.height, "depth_scale": 1000 * metres_per_unit,
    }  # fmt: skip


def _info(numbers: Mapping[str, int]) -> str:
    scenes = "".join(f"- {number:06d}: {name}\n" for name, number in numbers.items())
    return (
        "# Labels made by rpl-data\n\nPoses and models are in the frame of each object's keypoint model, "
        f"whose origin is the centroid of the keypoints.\n\nScenes:\n\n{scenes}"
    )


# Scenes -------------------------------------------------------------------------------------------


def _write_scene(
    folder: Path, coco: Path, images: Sequence[Json], split: Split, metres_per_unit: float
) -> int:
    """Write a scene's images of one split, and return the number of instances."""
    labels = {image["frame"]: split.annotations.get(image["id"], []) for image in images}
    info = {}
    for image in images:
        frame = image["frame"]
        source = coco / image["file_name"]
        link(source, folder / "rgb" / f"{frame:06d}{source.suffix}")
        measured = None
        if image["depth_file_name"] is not None:
            depth = coco / image["depth_file_name"]
            link(depth, folder / "depth" / f"{frame:06d}{depth.suffix}")
            measured = cv2.imread(str(depth), cv2.IMREAD_UNCHANGED)
        info[str(frame)] = [
            _write_instance(folder, f"{frame:06d}_{number:06d}.png", annotation, measured)
            for number, annotation in enumerate(labels[frame])
        ]
    write_scene_camera(
        folder,
        intrinsics_from_coco(images[0]),
        metres_per_unit,
        {image["frame"]: matrix_from_json(image["scene_from_camera"]) for image in images},
    )
    write_scene_gt(
        folder,
        {
            frame: [(a["category_id"], matrix_from_json(a["camera_from_object"])) for a in annotations]
            for frame, annotations in labels.items()
        },
    )
    write_json(folder / "scene_gt_info.json", info)
    return sum(map(len, labels.values()))


def _write_instance(scene_folder: Path, name: str, annotation: Json, measured: np.ndarray | None) -> Json:
    """Write both masks of an instance, and return its entry of scene_gt_info.json."""
    from pycocotools import mask as masks

    full = masks.decode(annotation["segmentation_full"]).view(np.bool_)
    visible = masks.decode(annotation["segmentation"]).view(np.bool_)
    for folder, mask in (("mask", full), ("mask_visib", visible)):
        content: bytes = cv2.imencode(".png", mask.astype(np.uint8) * 255)[1].tobytes()
        write_bytes(scene_folder / folder / name, content)
    valid = full if measured is None else full & (measured > 0)
    return {
        "bbox_obj": _box(full),
        "bbox_visib": _box(visible),
        "px_count_all": int(full.sum()),
        "px_count_valid": int(valid.sum()),
        "px_count_visib": int(visible.sum()),
        "visib_fract": annotation["visib_fract"],
    }


def _box(mask: Bool[np.ndarray, "height width"]) -> list[int]:
    """x, y, width, height as BOP counts them: from the first pixel to the last, not to its far edge."""
    rows, columns = np.nonzero(mask)
    if len(rows) == 0:
        return [-1, -1, -1, -1]
    x, y = int(columns.min()), int(rows.min())
    return [x, y, int(columns.max()) - x, int(rows.max()) - y]


def _targets(scene: int, images: Sequence[Json], split: Split) -> list[Json]:
    return [
        {"scene_id": scene, "im_id": image["frame"], "obj_id": annotation["category_id"], "inst_count": 1}
        for image in images
        for annotation in split.annotations.get(image["id"], [])
    ]


# Models -------------------------------------------------------------------------------------------


def _write_models(folder: Path, coco: Path, data: Json) -> list[str]:
    """Write the meshes in millimetres and models_info.json; returns the objects without a mesh."""
    info, missing = {}, []
    for number, item in enumerate(objects_from_coco(data), start=1):
        if item.mesh is None:
            missing.append(item.model.name)
            continue
        mesh = load_mesh(coco / item.mesh)
        mesh = replace(mesh, vertices=1000 * mesh.vertices)
        write_bytes(folder / f"obj_{number:06d}.ply", mesh_to_ply(mesh))
        info[str(number)] = _model_info(mesh) | _symmetries(item.symmetries)
    write_json(folder / "models_info.json", info)
    return missing


def _model_info(mesh: Mesh) -> Json:
    low, size = mesh.vertices.min(axis=0), np.ptp(mesh.vertices, axis=0)
    edges = {f"min_{axis}": float(value) for axis, value in zip("xyz", low, strict=True)}
    sizes = {f"size_{axis}": float(value) for axis, value in zip("xyz", size, strict=True)}
    return edges | sizes | {"diameter": _diameter(mesh.vertices)}


def _diameter(points: Float64[np.ndarray, "n 3"]) -> float:
    """Largest distance between two points, which are corners of the convex hull."""
    from scipy.spatial import ConvexHull
    from scipy.spatial.distance import pdist

    return float(pdist(points[ConvexHull(points).vertices]).max())


def _symmetries(symmetries: Sequence[Sequence[float]]) -> Json:
    """Rigid transforms that leave the object looking the same, translations in millimetres."""
    if not symmetries:
        return {}
    matrices = [np.array(values, dtype=np.float64).reshape(4, 4) for values in symmetries]
    return {"symmetries_discrete": [_in_mm(matrix).ravel().tolist() for matrix in matrices]}


def _in_mm(a_from_b: Float64[np.ndarray, "4 4"]) -> Float64[np.ndarray, "4 4"]:
    moved = a_from_b.copy()
    moved[:3, 3] *= 1000
    return moved
