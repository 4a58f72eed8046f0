"""BOP's layout (the benchmark for 6D object pose), for trainers and evaluations that read it.

::

    <folder>/camera.json, dataset_info.md
             test_targets_bop19.json, test_targets_bop24.json  poses, and images, that are asked for
             models/obj_000001.ply, models_info.json           millimetres, normals, the object frame
             models_eval/                                      the same, of few triangles
             {train,val,test}/000001/                          one folder per scene, see `recordings.bop`
                rgb/ depth/ mask/ mask_visib/
                scene_camera.json scene_gt.json scene_gt_info.json scene_gt_coco.json

The numbers of scene_gt_info.json count what the border of the image cuts off; masks end there. A scene has
the same number in every split; image ids are frame numbers.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2

from rpl_data.export.bop_instances import LEAST_VISIBLE, Silhouettes, coco_entry, write_instance
from rpl_data.export.bop_models import write_models
from rpl_data.export.color_images import ColorFormat, write_color
from rpl_data.export.dialect import DialectSummary, Split, splits_of
from rpl_data.export.folder import link, replacing
from rpl_data.files import write_json, write_text
from rpl_data.formats.datasets.coco import intrinsics_from_coco, objects_from_coco
from rpl_data.formats.recordings.bop import write_scene_camera, write_scene_gt
from rpl_data.json_arrays import Json, matrix_from_json


def export_bop(
    folder: Path, coco: Path, metres_per_unit: Mapping[str, float], color: ColorFormat = "recorded"
) -> DialectSummary:
    """Write `folder` from an exported COCO folder; images are linked, masks are written.

    Args:
        folder: folder to write; its old content is replaced.
        coco: the exported COCO folder.
        metres_per_unit: unit of the depth images, by scene name.
        color: format of the colour images. In PNG, `rgb` in the path of an image can be replaced by `depth`.

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
            objects = objects_from_coco(split.data)
            whole = Silhouettes(coco, objects)
            for scene in sorted({image["scene"] for image in split.images}):
                mine = [image for image in split.images if image["scene"] == scene]
                place = building / split.name / f"{numbers[scene]:06d}"
                info = write_scene(place, coco, mine, split, metres_per_unit[scene], whole, color)
                instances += sum(map(len, info.values()))
                if split.name == "test":
                    targets += _pose_targets(numbers[scene], mine, split, info)
                cameras.append(_camera(mine[0], metres_per_unit[scene]))
        without_mesh = write_models(building, coco, objects)
        write_json(building / "camera.json", cameras[0])
        if targets:
            write_json(building / "test_targets_bop19.json", targets)
            write_json(building / "test_targets_bop24.json", _detection_targets(targets))
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
        "whose origin is the centroid of the keypoints. Pixel (0, 0) has its centre at (0, 0), as in OpenCV: "
        f"project with cam_K as it is, and rasterise at whole numbers.\n\nScenes:\n\n{scenes}"
    )


# Scenes -------------------------------------------------------------------------------------------


def write_scene(
    folder: Path,
    coco: Path,
    images: Sequence[Json],
    split: Split,
    metres_per_unit: float,
    whole: Silhouettes,
    color: ColorFormat,
) -> dict[int, list[Json]]:
    """Write a scene's images of one split; returns the entries of scene_gt_info.json by frame number."""
    labels = {image["frame"]: split.annotations.get(image["id"], []) for image in images}
    colors: dict[int, Path] = {}
    info: dict[int, list[Json]] = {}
    for image in images:
        frame = image["frame"]
        colors[frame] = write_color(coco / image["file_name"], folder / "rgb" / f"{frame:06d}", color)
        measured = None
        if image["depth_file_name"] is not None:
            depth = coco / image["depth_file_name"]
            link(depth, folder / "depth" / f"{frame:06d}{depth.suffix}")
            measured = cv2.imread(str(depth), cv2.IMREAD_UNCHANGED)
        info[frame] = [
            write_instance(folder, f"{frame:06d}_{number:06d}.png", image, annotation, measured, whole)
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
    write_json(folder / "scene_gt_info.json", {str(frame): entries for frame, entries in info.items()})
    write_json(folder / "scene_gt_coco.json", _scene_coco(colors, images, labels, info, split))
    return info


def _scene_coco(
    colors: Mapping[int, Path],
    images: Sequence[Json],
    labels: Mapping[int, list[Json]],
    info: Mapping[int, list[Json]],
    split: Split,
) -> Json:
    """A scene as the toolkit's own `calc_gt_coco.py` writes it: categories are called by their numbers."""
    annotations: list[Json] = []
    for image in images:
        for label, numbers in zip(labels[image["frame"]], info[image["frame"]], strict=True):
            annotations.append(coco_entry(len(annotations) + 1, image, label, numbers))
    return {
        "info": {"description": f"{split.name}, made by rpl-data"},
        "licenses": [],
        "categories": [
            {"id": item["id"], "name": str(item["id"]), "supercategory": item["name"]}
            for item in split.data["categories"]
        ],
        "images": [
            {
                "id": image["frame"],
                "file_name": f"rgb/{colors[image['frame']].name}",
                "width": image["width"],
                "height": image["height"],
            }
            for image in images
        ],
        "annotations": annotations,
    }


def _detection_targets(targets: Sequence[Json]) -> list[Json]:
    """The images in which objects are to be detected; which objects is for the detector to say."""
    places = dict.fromkeys((target["scene_id"], target["im_id"]) for target in targets)
    return [{"scene_id": scene, "im_id": frame} for scene, frame in places]


def _pose_targets(
    scene: int, images: Sequence[Json], split: Split, info: Mapping[int, list[Json]]
) -> list[Json]:
    """Which poses are asked for: of how many instances of an object enough is visible in an image."""
    counts = Counter(
        (image["frame"], annotation["category_id"])
        for image in images
        for annotation, numbers in zip(
            split.annotations.get(image["id"], []), info[image["frame"]], strict=True
        )
        if numbers["visib_fract"] >= LEAST_VISIBLE
    )
    return [
        {"scene_id": scene, "im_id": frame, "obj_id": category, "inst_count": count}
        for (frame, category), count in counts.items()
    ]
