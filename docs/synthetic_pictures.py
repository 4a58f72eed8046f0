"""Make the pictures of the page "More views by rendering" from a workspace with export/synthetic.

    python docs/synthetic_pictures.py my-workspace

One shows rendered images with their labels, the other recorded crops that coloured nothing, above the same
poses rendered anew in the light of their scenes.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from rpl_data import Workspace
from rpl_data.formats.datasets.coco import (
    intrinsics_from_coco,
    labels_from_coco,
    objects_from_coco,
    read_coco,
)
from rpl_data.images import read_pixels
from rpl_data.json_arrays import Json, matrix_from_json
from rpl_data.overlay import draw_overlay
from rpl_data.synthesize.compose import laid_over
from rpl_data.synthesize.light import Light
from rpl_data.synthesize.render import Placed, draw, finer_table
from rpl_data.synthesize.storage import load_studio
from rpl_data.synthesize.studio import Noise, Studio

HERE = Path(__file__).parent
SIDE_PX = 200
QUIET = Noise(0.0, 0.0, 0.0, 0.0)


def main(folder: str) -> None:
    """Write docs/synthesize_*.jpg."""
    workspace = Workspace(folder)
    save("synthesize_views.jpg", labelled(workspace.export("synthetic"), 4))
    studio = load_studio(workspace.export("synthetic") / "studio")
    save("synthesize_beside.jpg", beside_recorded(workspace.export("coco"), studio, 6))


def labelled(folder: Path, count: int) -> np.ndarray:
    """Rendered images with their labels, two in a row."""
    data = read_coco(folder / "train.json")
    models = {item.model.name: item.model for item in objects_from_coco(data)}
    rendered = [n for n, image in enumerate(data["images"]) if image["origin"] == "synthetic"][:count]
    labels = labels_from_coco(data)
    drawn = [
        draw_overlay(picture(folder, data["images"][number]), labels[number], models) for number in rendered
    ]
    return np.vstack([np.hstack(drawn[row : row + 2]) for row in range(0, count, 2)])


def beside_recorded(folder: Path, studio: Studio, count: int) -> np.ndarray:
    """Recorded crops of validation frames, and the same poses rendered."""
    data = read_coco(folder / "val.json")
    images = {image["id"]: image for image in data["images"]}
    names = {category["id"]: category["name"] for category in data["categories"]}
    shown = [one for one in data["annotations"] if one["visib_fract"] > 0.9 and _is_shown(one, names, studio)]
    chosen = [shown[row] for row in np.linspace(0, len(shown) - 1, count).astype(int)]
    columns = []
    for one in chosen:
        image = images[one["image_id"]]
        recorded = picture(folder, image)
        pair = recorded, rendered_like(recorded, image, one, names[one["category_id"]], studio)
        columns.append(np.vstack([crop(each, one["square_box"]) for each in pair]))
    return np.hstack(columns)


def _is_shown(annotation: Json, names: dict[int, str], studio: Studio) -> bool:
    name = names[annotation["category_id"]]
    return name in studio.subjects and bool(studio.subjects[name].shown.any())


def rendered_like(
    recorded: np.ndarray, image: Json, annotation: Json, name: str, studio: Studio
) -> np.ndarray:
    """The recorded image with the object rendered over itself."""
    turn = matrix_from_json(image["scene_from_camera"])[:3, :3]
    light = Light(turn, studio.subjects[name].lights[image["scene"]].coefficients)
    placed = Placed(studio.subjects[name].body, matrix_from_json(annotation["camera_from_object"]))
    drawing = draw(finer_table(intrinsics_from_coco(image)), [placed], {name: light})
    return laid_over(recorded, drawing, QUIET, np.random.default_rng(0))


def picture(folder: Path, image: Json) -> np.ndarray:
    """An image of an export."""
    found = read_pixels(folder / image["file_name"])
    assert found is not None
    return found


def crop(image: np.ndarray, square_box: list[float]) -> np.ndarray:
    """What a square box shows."""
    cx, cy, side = square_box
    zoom = SIDE_PX / side
    shift = np.array([[zoom, 0, SIDE_PX / 2 - zoom * cx], [0, zoom, SIDE_PX / 2 - zoom * cy]])
    return cv2.warpAffine(image, shift, (SIDE_PX, SIDE_PX), flags=cv2.INTER_LINEAR)


def save(name: str, picture: np.ndarray) -> None:
    """Write a picture for the page, 1200 pixels wide at most."""
    zoom = min(1.0, 1200 / picture.shape[1])
    small = cv2.resize(picture, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(HERE / name), small[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(sys.argv[1])
