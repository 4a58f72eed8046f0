"""`rpl synthesize`: render images into a COCO folder, alone or together with recorded ones.

An image depends on the seed and its number alone. Finished images wait in a folder beside the one to be
written, so that an interrupted run goes on; when all are there, the folder gets its name.
"""

from __future__ import annotations

import json
import shutil
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from rpl_data.export.folder import Filling, replacing
from rpl_data.export.split import SplitName
from rpl_data.files import write_bytes, write_json
from rpl_data.formats.datasets.coco import CocoObject, header, image_to_coco, instance_to_coco
from rpl_data.formats.datasets.coco_entries import writing_entries
from rpl_data.formats.datasets.coco_parts import ByImage, read_packed
from rpl_data.formats.datasets.scene_samples import samples_by_scene
from rpl_data.formats.recordings.saved_images import encoded
from rpl_data.json_arrays import Json
from rpl_data.meshes import save_mesh
from rpl_data.pipeline.ledger import Advance
from rpl_data.pipeline.synthesis.pictures import Picture, picture
from rpl_data.pipeline.synthesis.training import Training
from rpl_data.synthesize.painted import steps_of
from rpl_data.synthesize.storage import STUDIO_FILE
from rpl_data.synthesize.studio import Studio
from rpl_data.types import DataError, Frame, Mesh
from rpl_data.wording import counted

SCENE = "synthetic"
"""Name of the scene that rendered images are of."""
SPOOL, JOB = "images.jsonl", "job.json"
STUDIO = "studio"
"""Folder beside the splits with what the images were rendered from."""
REST: tuple[SplitName, ...] = ("val", "test")


@dataclass(frozen=True)
class Job:
    """What is asked for.

    Attributes:
        count: images to render.
        objects: names of the objects to show.
        width_px: width of the images; None keeps that of the recordings.
        mix: put the recorded training images beside them, and val and test as they are.
    """

    count: int
    objects: tuple[str, ...]
    width_px: int | None
    seed: int
    mix: bool


def check_target(out: Path, training: Training) -> None:
    """Ask this before any work is done.

    Raises:
        DataError: a scene of the recordings bears the name of the rendered one, or the folder holds something
            that `synthesize` did not write, which would be lost.
    """
    if SCENE in training.scenes:
        raise DataError(f"a recording is called {SCENE}, as the rendered scene will be; rename it")
    ours = (out / STUDIO / STUDIO_FILE).is_file() and (out / "train.json").is_file()
    if out.exists() and not ours and not (out.is_dir() and not any(out.iterdir())):
        raise DataError(
            f"{out} exists and `rpl synthesize` did not write it, so it is not replaced; name another folder"
        )


def synthesize(
    out: Path,
    studio_folder: Path,
    studio: Studio,
    training: Training,
    job: Job,
    made_of: Json,
    advance: Advance,
) -> list[str]:
    """Render the images of a job and write the folder; returns lines for the user.

    Args:
        studio_folder: where the studio lies; the folder gets it as studio/, for `SyntheticKeypoints`.
        made_of: what the studio was made of; another one makes unfinished images worthless.
        advance: is told how many images are done.

    Raises:
        DataError: the disk is full.
    """
    unfinished = out.parent / f".{out.name}.unfinished"
    _begin(unfinished, {"job": asdict(job) | {"objects": list(job.objects)}, "made_of": made_of})
    skipped = _render(unfinished, studio, job, advance)
    with replacing(out) as building:
        lines = _write(building, unfinished, studio_folder, studio, training, job)
    shutil.rmtree(unfinished, ignore_errors=True)
    return [*lines, *_skipped_lines(skipped, studio, job)]


def _begin(folder: Path, task: Json) -> None:
    """Keep what an interrupted run of the same task finished; anything else is removed."""
    file = folder / JOB
    if file.exists() and json.loads(file.read_text()) == json.loads(json.dumps(task)):
        return
    shutil.rmtree(folder, ignore_errors=True)
    write_json(file, task)


def _finished(folder: Path) -> list[Json]:
    """The lines of the images that an interrupted run finished; a line that was cut off is dropped."""
    file = folder / SPOOL
    lines = file.read_text().splitlines(keepends=True) if file.exists() else []
    whole = [line for line in lines if line.endswith("\n")]
    if len(whole) < len(lines):
        file.write_text("".join(whole))
    return [json.loads(line) for line in whole]


def _render(folder: Path, studio: Studio, job: Job, advance: Advance) -> Counter[str]:
    made, skipped = Counter[str](), Counter[str]()
    finished = _finished(folder)
    for line in finished:
        made.update(line["objects"])
        skipped.update(line["skipped"])
    with (folder / SPOOL).open("a") as spool:
        for number in range(len(finished), job.count):
            advance(number, job.count)
            found = picture(studio, job.objects, number, seed=job.seed, made=made, width_px=job.width_px)
            line = _line(folder, number, found)
            spool.write(json.dumps(line, allow_nan=False) + "\n")
            spool.flush()
            made.update(line["objects"])
            skipped.update(found.skipped)
    advance(job.count, job.count)
    return skipped


def _line(folder: Path, number: int, found: Picture) -> Json:
    """Write the files of an image; returns its entries, ids not yet given."""
    color, depth = f"images/{SCENE}/{number:06d}.jpg", None
    write_bytes(folder / color, encoded(found.color[..., ::-1], "jpg"))
    if found.depth is not None:
        depth = f"depth/{SCENE}/{number:06d}.png"
        write_bytes(folder / depth, encoded(found.depth, "png"))
    entry = image_to_coco(
        0,
        Frame(number, float(number), folder / color, None),
        scene=SCENE,
        intrinsics=found.plate.camera,
        scene_from_camera=np.eye(4),
        file_name=color,
        depth_file_name=depth,
        metres_per_unit=found.plate.metres_per_unit,
    )
    entry["origin"] = "synthetic"
    entry["plate"] = {"scene": found.plate.scene, "frame": found.plate.frame}
    annotations = [
        one for instance in found.instances if (one := instance_to_coco(0, 0, 0, instance)) is not None
    ]
    names = [instance.object for instance in found.instances if instance.box is not None]
    return {
        "image": entry,
        "annotations": annotations,
        "objects": names,
        "skipped": dict(found.skipped),
    }


# The folder ---------------------------------------------------------------------------------------


def _write(
    building: Path, unfinished: Path, studio_folder: Path, studio: Studio, training: Training, job: Job
) -> list[str]:
    files = Filling()
    for path in sorted(path for path in studio_folder.rglob("*") if path.is_file()):
        files.share(path, building / STUDIO / path.relative_to(studio_folder))
    objects = _objects(building, studio, training)
    top = header(objects)
    top["rpl"]["synthetic"] = {
        "scenes": list(studio.scenes),
        "seed": job.seed,
        "images": job.count,
        "objects": list(job.objects),
        "images_of": samples_by_scene(training.folder, training.data["images"]),
    }
    numbers = {item.model.name: number for number, item in enumerate(objects, start=1)}
    taken = [(0, 0)]  # the highest ids of each split: rendered images follow all of them
    for split in REST if job.mix else ():
        if (training.folder / f"{split}.json").exists():
            with writing_entries(building / f"{split}.json", top) as writer:
                data = read_packed(training.folder / f"{split}.json")
                taken.append(_take(writer.add, building, training.folder, data, files))
    with writing_entries(building / "train.json", top) as writer:
        if job.mix:
            taken.append(_take(writer.add, building, training.folder, training.data, files))
        image_id, annotation_id = map(max, zip(*taken, strict=True))
        for line in _finished(unfinished):
            image_id += 1
            entries = []
            for one, name in zip(line["annotations"], line["objects"], strict=True):
                annotation_id += 1
                entries.append(
                    one | {"id": annotation_id, "image_id": image_id, "category_id": numbers[name]}
                )
            for name in filter(None, (line["image"]["file_name"], line["image"]["depth_file_name"])):
                files.share(unfinished / name, building / name)
            writer.add(line["image"] | {"id": image_id}, entries)
    recorded = counted(len(training.data["images"]), "recorded image")
    together = f" beside {recorded}" if job.mix else ""
    return [
        f"{counted(job.count, 'image')} rendered{together}, of scenes {', '.join(studio.scenes)} alone",
    ]


def _take(
    add: Callable[[Json, list[Json]], None], building: Path, folder: Path, data: Json, files: Filling
) -> tuple[int, int]:
    """Take recorded images as they are; returns the highest ids of images and annotations."""
    by_image, last = ByImage(data["annotations"], data.get("crowds", ())), 0
    for image in data["images"]:
        for name in filter(None, (image["file_name"], image["depth_file_name"])):
            files.share(folder / name, building / name)
        entries = by_image.get(image["id"], [])
        add(image | {"origin": "recorded"}, entries)
        last = max((last, *(one["id"] for one in entries)))
    return max((image["id"] for image in data["images"]), default=0), last


def _objects(building: Path, studio: Studio, training: Training) -> list[CocoObject]:
    """The objects of the export, with the meshes that were rendered."""
    objects = []
    for item in training.objects:
        name, mesh = item.model.name, None
        if name in studio.subjects:
            painted = studio.subjects[name].body.painted
            mesh = f"meshes/{name}.ply"
            save_mesh(building / mesh, _with_vertex_colors(painted.mesh, painted.texels), seen=painted.seen)
        objects.append(replace(item, mesh=mesh))
    return objects


def _with_vertex_colors(mesh: Mesh, texels: np.ndarray) -> Mesh:
    """The mesh with the colours of its corners' texels: first, last of the first row, and last."""
    steps = steps_of(texels.shape[1])
    colors = np.zeros((len(mesh.vertices), 3), np.uint8)
    # In the order of `painted.grid`: (0, 0), (steps, 0), (0, steps).
    for corner, texel in enumerate((0, texels.shape[1] - 1, steps)):
        colors[mesh.triangles[:, corner]] = texels[:, texel]
    return replace(mesh, colors=colors)


def _skipped_lines(skipped: Counter[str], studio: Studio, job: Job) -> list[str]:
    lines = [
        f"{name}: {1 - studio.subjects[name].shown.mean():.0%} of all directions are never shown, for no "
        "training scene saw its surface from there"
        for name in job.objects
        if studio.subjects[name].shown.mean() < 0.995
    ]
    if skipped["unseen surface"]:
        lines.append(f"{counted(skipped['unseen surface'], 'view')} skipped that would show unseen surface")
    return lines
