"""Judged poses in the words of the field: BOP's results and recalls, the curve of ADD, OKS precision."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np

from rpl_data.files import read_json
from rpl_data.formats.datasets.bop_results import PoseResult
from rpl_data.formats.datasets.coco import depth_unit_m, intrinsics_from_coco, objects_from_coco, read_coco
from rpl_data.geometry import Transform
from rpl_data.json_arrays import Json, matrix_from_json
from rpl_data.meshes import load_mesh
from rpl_data.pose.average_recall import PIXELS, SHARES, Answers, add_auc, average_recall
from rpl_data.pose.benchmark import (
    BenchmarkErrors,
    BenchmarkModel,
    benchmark_errors,
    benchmark_model,
)
from rpl_data.pose.benchmark_errors import VSD_TAUS
from rpl_data.pose.oks import SeenInImage, average_precision, oks

from .pipeline import SeenKeypoints, read_depth_like
from .scores import Judged, errors_table


@dataclass(frozen=True)
class BenchmarkScore:
    """Scores of one object under one PnP method; NaN where there is nothing to judge.

    Attributes:
        average_recall: BOP19's AR, the mean of the next three; None without depth, which VSD needs.
        recall_vsd, recall_mssd, recall_mspd: mean recall over the benchmark's thresholds.
        auc_add, auc_adds: area under the share of poses over the ADD (ADD-S) that is allowed, to 0.1 m.
        oks_ap, oks_ap50: COCO's keypoint precision, of thresholds 0.5 to 0.95 and of 0.5, in the images
            that show the object; what is detected where it is not, they do not count.
    """

    average_recall: float | None
    recall_vsd: float | None
    recall_mssd: float
    recall_mspd: float
    auc_add: float
    auc_adds: float
    oks_ap: float
    oks_ap50: float


@dataclass(frozen=True)
class Shown:
    """The true instances of one object in one image, and what was estimated there.

    Attributes:
        image: entry of the COCO file.
        annotations: entries of the instances.
        judged: one per instance.
    """

    image: Json
    annotations: tuple[Json, ...]
    judged: tuple[Judged, ...]

    @property
    def poses(self) -> list[tuple[Transform, float]]:
        """The estimated poses, ``camera_from_object``, each with its confidence."""
        return [
            (one.pose, _confidence(one.seen))
            for one in self.judged
            if one.pose is not None and one.seen is not None
        ]

    @property
    def seen(self) -> list[SeenKeypoints]:
        """The keypoints of what was detected, or of the crops that were given."""
        return [one.seen for one in self.judged if one.seen is not None]


class Benchmark:
    """Scores judged poses against a true export."""

    def __init__(self, coco_json: Path, *, metres_per_unit: float | None, least_visible: float = 0.1) -> None:
        """Read the truth.

        Args:
            coco_json: the split that was judged.
            metres_per_unit: of the depth images of an export that does not say it. Without depth, or its
                unit, there is no VSD.
            least_visible: what was judged shows at least this share of itself.
        """
        self._folder, self._told_m = coco_json.parent, metres_per_unit
        data = read_coco(coco_json)
        self._has_depth = all(
            image["depth_file_name"] is not None and (metres_per_unit or image.get("metres_per_unit"))
            for image in data["images"]
        )
        self._images = {image["file_name"]: image for image in data["images"]}
        self._objects = {item.model.name: item for item in objects_from_coco(data)}
        self._numbers = {item["name"]: int(item["id"]) for item in data["categories"]}
        self._labels: dict[tuple[int, int], list[Json]] = {}
        for annotation in data["annotations"]:
            if annotation["visib_fract"] >= least_visible:
                key = annotation["image_id"], annotation["category_id"]
                self._labels.setdefault(key, []).append(annotation)
        self._scenes = scene_numbers(self._folder)
        self._model = cache(self._load_model)

    def score(self, judged: Sequence[Judged]) -> BenchmarkScore:
        """Score the instances of one object under one method."""
        shown = list(self._shown(judged))
        errors = [self._errors(each) for each in shown]
        surfaces = None
        if self._has_depth:
            surfaces = float(np.mean([_recall_vsd(shown, errors, tau) for tau in range(len(VSD_TAUS))]))
        mssd = average_recall(_answers(shown, [[e.mssd for e in row] for row in errors]), SHARES)
        mspd = average_recall(_answers(shown, [[e.mspd_px for e in row] for row in errors]), PIXELS)
        add_m, adds_m = errors_table(judged)[:, 2:].T
        seen = [_keypoints(each) for each in shown]
        return BenchmarkScore(
            average_recall=None if surfaces is None else (surfaces + mssd + mspd) / 3,
            recall_vsd=surfaces,
            recall_mssd=mssd,
            recall_mspd=mspd,
            auc_add=add_auc(add_m),
            auc_adds=add_auc(adds_m),
            oks_ap=average_precision(seen),
            oks_ap50=average_precision(seen, np.array([0.5])),
        )

    def results(self, judged: Sequence[Judged]) -> Iterator[PoseResult]:
        """The poses as BOP takes them: scenes are numbered by name, images by frame, objects by category."""
        for shown in self._shown(judged):
            scene, frame = self._scenes[shown.image["scene"]], int(shown.image["frame"])
            number = self._numbers[shown.judged[0].object]
            for pose, confidence in shown.poses:
                yield PoseResult(scene, frame, number, confidence, pose)

    def _shown(self, judged: Sequence[Judged]) -> Iterator[Shown]:
        """Group the instances of one object and method by image; labels were judged in their order."""
        groups: dict[tuple[str, str], list[Judged]] = {}
        for each in judged:
            groups.setdefault((each.image, each.object), []).append(each)
        for (name, object), group in groups.items():
            image = self._images[name]
            yield Shown(image, tuple(self._labels[image["id"], self._numbers[object]]), tuple(group))

    def _errors(self, shown: Shown) -> list[BenchmarkErrors]:
        """Errors of each estimated pose relative to each instance, pose after pose."""
        if not shown.poses:
            return []
        depth = None
        if self._has_depth:
            unit_m = depth_unit_m(shown.image, self._told_m)
            like = np.empty((shown.image["height"], shown.image["width"], 3), np.uint8)
            depth = read_depth_like(self._folder / str(shown.image["depth_file_name"]), unit_m, like=like)
        model, camera = self._model(shown.judged[0].object), intrinsics_from_coco(shown.image)
        true_poses = [matrix_from_json(label["camera_from_object"]) for label in shown.annotations]
        return [
            benchmark_errors(model, pose, true, intrinsics=camera, measured_m=depth)
            for (pose, _), true in product(shown.poses, true_poses)
        ]

    def _load_model(self, name: str) -> BenchmarkModel:
        item = self._objects[name]
        return benchmark_model(load_mesh(self._folder / str(item.mesh)), item.symmetries)


def scene_numbers(folder: Path) -> Mapping[str, int]:
    """Numbers of the scenes of all splits, as the BOP export counts them: from 1, by name."""
    names = {
        image["scene"]
        for split in ("train", "val", "test")
        if (folder / f"{split}.json").exists()
        for image in read_json(folder / f"{split}.json")["images"]
    }
    return {name: number for number, name in enumerate(sorted(names), start=1)}


def _confidence(seen: SeenKeypoints) -> float:
    """Score of the detection times the mean confidence of its keypoints."""
    return float(seen.score * seen.confidence.mean())


def _answers(shown: Sequence[Shown], errors: Sequence[Sequence[float]]) -> list[Answers]:
    found = []
    for each, row in zip(shown, errors, strict=True):
        table = np.array(row, dtype=np.float64).reshape(-1, len(each.annotations))
        found.append(Answers(np.array([confidence for _, confidence in each.poses]), table))
    return found


def _recall_vsd(shown: Sequence[Shown], errors: Sequence[Sequence[BenchmarkErrors]], tau: int) -> float:
    rows = [[float(e.vsd[tau]) for e in row if e.vsd is not None] for row in errors]
    return average_recall(_answers(shown, rows), SHARES)


def _keypoints(shown: Shown) -> SeenInImage:
    """The detected keypoints of an image beside the true ones; nothing where none are labelled."""
    true = [label for label in shown.annotations if label["num_keypoints"]]
    similar = [[_similarity(seen.positions_px, label) for label in true] for seen in shown.seen]
    scores = np.array([_confidence(seen) for seen in shown.seen])
    return SeenInImage(scores, np.array(similar, dtype=np.float64).reshape(len(scores), len(true)))


def _similarity(found_px: np.ndarray, label: Json) -> float:
    flat = np.array(label["keypoints"], dtype=np.float64).reshape(-1, 3)
    return oks(found_px, flat[:, :2], flat[:, 2].astype(np.int64), area_px=float(label["area"]))
