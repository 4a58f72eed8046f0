"""Table II: one run on the tiny workspace, its resumption, and the arithmetic of its comparison."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rpl_data.pose.errors import INFINITE, PoseErrors
from rpl_data.types import DataError
from rpl_data.workspace.workspace import Workspace
from training.pose.scores import Judged, PoseScore
from training.reproduce.label_sources import same_images
from training.reproduce.table2 import pose_comparison
from training.reproduce.table2.experiment import check_objects, table2
from training.reproduce.table2.page import interval_note, verdict
from training.reproduce.table2.pose_comparison import (
    PROTOCOLS,
    Cell,
    Ratio,
    counts,
    ratios,
    refuse_trained,
    resampled_medians,
)
from training.runs.options import DetectorNetwork, Learning, Machine, Network

NETWORK = Network(stacks=1, features=16, levels=2, input_px=32, heatmap_px=8, loss="entropy")
DETECTOR = DetectorNetwork(width_px=96, features=32)
LEARNING = Learning(epochs=1, batch=4, optimizer="adam", rate=2e-3)
ONE = Machine(accelerator="cpu", threads=1)
SCORE = PoseScore(4, 0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, pck=0.9)


def test_table_of_a_workspace_is_made_once(
    tiny_workspace: Workspace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = tmp_path / "tiny"
    shutil.copytree(tiny_workspace.root, place)  # the true labels are exported into it

    def run(epochs: int) -> str:
        learning = replace(LEARNING, epochs=epochs)
        table2(
            place, ["carton"], tmp_path, NETWORK, learning,
            detector=DETECTOR, detector_learning=LEARNING, machine=ONE,
        )  # fmt: skip
        return capsys.readouterr().out

    assert run(1).count("s of CPU time") == 4
    found = json.loads((tmp_path / "table2.json").read_text())
    rows = {(c["source"], c["split"], c["crops"], c["method"]): c for c in found["cells"]}
    assert len(rows) == len(found["cells"]) == 16 and {key[1:3] for key in rows} == set(PROTOCOLS)
    for split in ("val", "test"):
        assert len({c["score"]["instances"] for (_, s, *_), c in rows.items() if s == split}) == 1
    for cell in rows.values():
        low, high = (np.inf if value is None else value for value in cell["position_95"])
        assert low <= (cell["score"]["position_mm"] or np.inf) <= high
    assert found["counts"] == {"carton": {"val": False, "test": False}} and len(found["ratios"]) == 16
    runs = {f"{s}/seed0/{what}" for s in ("OURS", "MANUAL") for what in ("carton", "detector")}
    assert set(found["seconds"]) == runs
    page = (tmp_path / "table2.html").read_text()
    assert "does not count" in page and (tmp_path / "table2_curves.png").exists()
    assert "s of CPU time" not in run(1)
    assert run(2).count("s of CPU time") == 2  # the hourglasses go on, the detectors are done


def test_unknown_objects_are_refused_before_any_training(tiny_workspace: Workspace) -> None:
    labels = tiny_workspace.export("coco") / "train.json"
    check_objects(["carton"], labels)
    for names, said in ((["carton", "cartn"], "no object cartn; .* carton"), ([], "no object is named")):
        with pytest.raises(DataError, match=said):
            check_objects(names, labels)


def test_true_labels_of_another_split_are_not_taken(tmp_path: Path) -> None:
    ours, manual = tmp_path / "coco", tmp_path / "coco_truth"
    for folder in (ours, manual):
        folder.mkdir()
        (folder / "train.json").write_text('{"images": [{"file_name": "images/00/0.jpg"}]}')
    assert same_images(ours, manual) and not same_images(ours, tmp_path / "none")
    (ours / "test.json").write_text('{"images": []}')
    assert not same_images(ours, manual)


def test_networks_that_saw_what_is_tested_by_now_are_refused(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(pose_comparison, "trained_scenes", lambda checkpoint, coco_json: ["01"])
    with pytest.raises(DataError, match=r"last.ckpt was trained on scene 01, which test.json tests by now"):
        refuse_trained([Path("last.ckpt")], Path("test.json"))
    monkeypatch.setattr(pose_comparison, "trained_scenes", lambda checkpoint, coco_json: [])
    refuse_trained([Path("last.ckpt")], Path("test.json"))


def judged(position_mm: float, *, failed: bool = False) -> Judged:
    errors = INFINITE if failed else PoseErrors(1e-3 * position_mm, 1e-2 * position_mm, 0.0, 0.0)
    return Judged("drill", "1.jpg", "epnp", "ok", errors, np.zeros(1), None, None)


def cell(source: str, *, split: str = "val", crops: str = "given", pck: float = 0.9) -> Cell:
    return Cell("drill", source, split, crops, "epnp", replace(SCORE, pck=pck))


def test_ratio_of_medians_by_hand() -> None:
    errors = [1.0, 2.0, 3.0, 4.0, 5.0]
    ours = [judged(1.2 * error) for error in errors]
    found = ratios([(cell("OURS"), [ours]), (cell("MANUAL"), [[judged(error) for error in errors]])])
    assert [ratio.figure for ratio in found] == ["position", "orientation"]
    for ratio in found:  # pairs are drawn, and every pair has the same ratio
        assert (ratio.value, ratio.low, ratio.high) == pytest.approx((1.2, 1.2, 1.2))


def test_ratio_counts_failures_as_infinite() -> None:
    fine = [judged(1.0)] * 5
    broken = [judged(1.0)] * 2 + [judged(0.0, failed=True)] * 3
    for ratio in ratios([(cell("OURS"), [broken]), (cell("MANUAL"), [fine])]):
        assert ratio.value == np.inf and ratio.high == np.inf and verdict(ratio) == "no, not surely"
    for ratio in ratios([(cell("OURS"), [broken]), (cell("MANUAL"), [broken])]):
        assert np.isnan(ratio.value) and verdict(ratio) == "no ratio"


def test_intervals_cover_frames_and_seeds() -> None:
    """With one seed all resamples of equal frames agree; seeds that differ widen the interval."""
    same = np.full((1, 6, 2), 3.0)
    np.testing.assert_array_equal(resampled_medians(same), np.full((2000, 2), 3.0))
    apart = np.concatenate([same, same + 2])
    assert set(np.unique(resampled_medians(apart))) == {3.0, 4.0, 5.0}  # one, both or the other seed drawn
    assert "one seed" in interval_note(1) and "and 3 seeds" in interval_note(3)


@pytest.mark.parametrize(("value", "low", "high", "expected"), [
    (1.0, 0.9, 1.1, "yes"), (1.1, 0.9, 1.3, "yes, not surely"),
    (1.2, 1.0, 1.4, "no, not surely"), (1.4, 1.2, np.inf, "no"),
])  # fmt: skip
def test_verdict_says_what_the_interval_leaves_open(value, low, high, expected) -> None:
    assert verdict(Ratio("drill", "val", "given", "epnp", "position", value, low, high)) == expected


def test_ratio_of_unlike_instances_is_none() -> None:
    assert ratios([(cell("OURS"), [[judged(1.0)]]), (cell("MANUAL"), [[judged(1.0)] * 2])]) == []


@pytest.mark.parametrize(("source", "split", "crops", "pck", "expected"), [
    ("MANUAL", "test", "given", 0.8, True), ("MANUAL", "test", "given", 0.79, False),
    ("OURS", "test", "given", 0.9, False), ("MANUAL", "val", "given", 0.9, False),
    ("MANUAL", "test", "detected", 0.9, False),
])  # fmt: skip
def test_comparison_counts_when_manual_has_learned(source, split, crops, pck, expected) -> None:
    assert counts([cell(source, split=split, crops=crops, pck=pck)], "drill", "test") is expected
