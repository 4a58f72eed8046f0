"""Each parser reads many damaged files in a process of its own: it returns, or refuses in a DataError."""

from __future__ import annotations

import json
import random
import time
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from attack.children import ended
from attack.container_parsers import container_seeds
from attack.damage import bytes_of, fields_of, words_of
from attack.recorder_parsers import recorder_seeds

BATCH = 500
"""Inputs that one child reads; how a child of several ended is known for the last of them only."""
SLOWEST_S = 5.0

Parser = Callable[[Path], Any]


def seeds(folder: Path) -> Iterator[tuple[str, Path, Parser]]:
    """A good file of each kind, and what reads it."""
    from scipy.io import savemat

    from rpl_data.clicks.table import clicks_from_csv
    from rpl_data.files import read_json, read_text
    from rpl_data.formats.containers import klg, mat, rosbag
    from rpl_data.formats.models import meshlab, meta_data, sparse_model, surfels
    from rpl_data.formats.recordings import camera_file, pose_lines
    from rpl_data.meshes import load_cloud, load_mesh, mesh_to_ply, save_cloud
    from rpl_data.pipeline.recipe_file import load_recipe
    from rpl_data.types import Mesh, PointCloud

    chance = np.random.default_rng(0)
    points = chance.random((12, 3))
    mesh = Mesh(points, chance.integers(0, 12, (20, 3)), np.full((12, 3), 80, np.uint8))
    (folder / "mesh.ply").write_bytes(mesh_to_ply(mesh))
    yield "binary PLY", folder / "mesh.ply", load_mesh
    text = ["ply", "format ascii 1.0", "element vertex 3", *(f"property float {axis}" for axis in "xyz")]
    text += [
        "element face 1",
        "property list uchar int vertex_indices",
        "end_header",
        "0 0 0",
        "1 0 0",
        "0 1 0",
    ]
    (folder / "text.ply").write_text("\n".join([*text, "3 0 1 2", ""]))
    yield "text PLY", folder / "text.ply", load_mesh
    cloud = PointCloud(points + 1, -np.ones((12, 3)) / 3**0.5, np.zeros((12, 3), np.uint8))
    save_cloud(folder / "cloud.ply", cloud)
    yield "PLY as a cloud", folder / "cloud.ply", load_cloud
    surfels.write_surfels(folder / "surfels.ply", surfels.Surfels(cloud, np.ones(12)))
    yield "surfels", folder / "surfels.ply", surfels.read_surfels
    arrays = {
        "poses": chance.random((3, 4, 2)),
        "cls_indexes": np.array([[1], [2]]),
        "factor_depth": np.array([[1.0]]),
    }
    for packed in (True, False):
        path = folder / f"meta{packed:d}.mat"
        savemat(path, arrays, do_compression=packed)
        yield f"meta.mat{' packed' if packed else ''}", path, partial(mat.read_mat, names=list(arrays))
    frames = [
        (33_333 * i, np.full((120, 160), 700, np.uint16), np.zeros((120, 160, 3), np.uint8)) for i in range(2)
    ]
    klg.write_klg(folder / "log.klg", frames)
    yield "klg", folder / "log.klg", _read_klg
    bag = Path(__file__).parents[1] / "data/realsense.bag"
    (folder / "short.bag").write_bytes(bag.read_bytes()[:60_000])
    yield "bag repair", folder / "short.bag", lambda path: rosbag.repair_bag(path, folder / "repaired.bag")
    sparse_model.write_sparse_model(folder / "sparse_model.txt", points, np.eye(4))
    yield "sparse model", folder / "sparse_model.txt", sparse_model.read_sparse_model
    yield "grasp", folder / "sparse_model.txt", sparse_model.read_grasp
    one = np.concatenate([np.zeros(6), [1, 0, 0, 0, 1, 0, 0, 0]])
    np.savez(folder / "meta.npz", model=points[:3], scenes=one, ref=np.ones((2, 3, 3)), sm=np.ones((18, 18)))
    yield "meta data", folder / "meta.npz", meta_data.read_meta_data
    meshlab.write_picked_points(folder / "points.pp", ["0", "1", "2"], points[:3])
    yield "picked points", folder / "points.pp", meshlab.read_picked_points
    (folder / "camera").mkdir()  # else it would be taken for the camera of the recordings that follow
    (folder / "camera/camera.txt").write_text(
        "600 600 320 240\ndistortion 0.1 0.2 0 0 0\nmetres_per_unit 0.001\n"
    )
    yield "camera", folder / "camera/camera.txt", camera_file.read_camera
    (folder / "poses.txt").write_text("".join(f"{t}.5 0 0 {t} 0 0 0 1\n" for t in range(9)))
    yield "poses", folder / "poses.txt", pose_lines.read_pose_lines
    rows = "".join(f"cup,{k},00,{k},5{k}.25,80\n" for k in range(3))
    (folder / "clicks.csv").write_text(f"object,keypoint,scene,frame,u_px,v_px\n{rows}")
    names = ["0", "1", "2"]
    yield (
        "clicks",
        folder / "clicks.csv",
        lambda path: clicks_from_csv(read_text(path), source=str(path), object_name="cup", keypoints=names),
    )
    (folder / "recipe.yaml").write_text(
        "name: x\nscenes: [{path: a, names: [b]}]\nobjects: [{name: c, keypoints: 4, skeleton: [[0, 1]]}]\n"
        "label: {rate: 3}\nsplit: {test_scenes: 1}\nexport: [coco]\n"
    )
    yield "recipe", folder / "recipe.yaml", load_recipe
    yield "COCO", _small_coco(folder), _read_coco
    (folder / "a.json").write_text('{"a": [1, 2.5, null, {"b": "c"}], "d": true}')
    yield "JSON", folder / "a.json", read_json
    yield from container_seeds(folder)
    yield from recorder_seeds(folder)


def _small_coco(folder: Path) -> Path:
    """An export of two objects in two images, whose masks have the forms that other programs write."""
    from labelled_scenes import exported

    path = exported(folder / "coco", frames=3) / "train.json"
    data = json.loads(path.read_text())
    x, y, w, h = data["annotations"][0]["bbox"]
    data["annotations"][0]["segmentation"] = [[x, y, x + w, y, x + w, y + h, x, y + h]]
    size = data["annotations"][1]["segmentation_full"]["size"]
    data["annotations"][1]["segmentation_full"]["counts"] = [100, 50, size[0] * size[1] - 150]
    data["annotations"].append(data["annotations"][2] | {"id": "90", "iscrowd": 1})
    path.write_text(json.dumps(data))
    return path


def _read_coco(path: Path) -> None:
    from rpl_data.formats.datasets import coco
    from rpl_data.torch.instances import InstanceDataset
    from rpl_data.torch.keypoints import KeypointDataset

    data = coco.read_coco(path)
    coco.labels_from_coco(data)
    for item in coco.objects_from_coco(data):
        len(KeypointDataset(path, object=item.model.name))
    instances = InstanceDataset(path)
    for row in range(len(instances)):
        instances.target(row)


def _read_klg(path: Path) -> None:
    from rpl_data.formats.containers import klg

    index = klg.index_klg(path)
    size = klg.klg_image_size(path, index)
    with path.open("rb") as file:
        for entry in index.entries:
            klg.klg_depth_mm(file, entry, size)
            klg.klg_color(file, entry, size)


def attack(scratch: Path, inputs: int, tell: Callable[[str], None]) -> Counter[str]:
    """Feed each parser so many damaged files; the number of ends by parser and kind of end."""
    counts: Counter[str] = Counter()
    for name, path, parse in seeds(scratch):
        mutate = (
            fields_of
            if name == "COCO"
            else words_of
            if path.suffix in (".txt", ".csv", ".yaml", ".pp", ".json")
            else bytes_of
        )
        good = path.read_bytes()
        control = ended(partial(_read_good, good, scratch / f"fed{path.suffix}", parse))
        if control.kind != "read":  # its damaged inputs would all be refused, and prove nothing
            counts[f"{name}: the good file: {control.kind}"] += 1
            tell(f"{control.kind}: {name}, the good file: {control.text[-1500:]}")
        for start in range(0, inputs, BATCH):
            batch = range(start, min(start + BATCH, inputs))
            end = ended(partial(_feed, good, scratch / f"fed{path.suffix}", parse, (mutate, bytes_of), batch))
            if end.kind.startswith("fed "):
                read, refused = map(int, end.kind.split()[1:])
                counts[f"{name}: read"] += read
                counts[f"{name}: refused"] += refused
            else:
                counts[f"{name}: {end.kind}"] += 1
                tell(f"{end.kind}: {name} in inputs {batch}: {end.text[-1500:]}")
    return counts


def _read_good(good: bytes, path: Path, parse: Parser) -> str:
    path.write_bytes(good)
    parse(path)
    return "read"


def _feed(good: bytes, path: Path, parse: Parser, kinds: tuple[Any, Any], batch: range) -> str:
    """How many of a batch were read, and how many were refused."""
    from rpl_data.types import DataError

    read = refused = 0
    for number in batch:
        path.write_bytes(kinds[number % 2](good, random.Random(number)))
        started = time.process_time()
        try:
            parse(path)
            read += 1
        except DataError:
            refused += 1
        assert time.process_time() - started < SLOWEST_S, f"input {number} took too long"
    return f"fed {read} {refused}"
