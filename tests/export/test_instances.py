"""Several instances of an object in an image: dialects carry them, or give each a folder of its own."""

import json
from dataclasses import replace

import pytest
from labelled_scenes import BOX, LAST_FRAME, two_boxes

from rpl_data.export import (
    export_bop,
    export_bundlesdf,
    export_coco,
    export_foundationpose,
    export_huggingface,
    export_yolo,
)
from rpl_data.export.checks import check_export
from rpl_data.export.split import SplitRule
from rpl_data.formats.datasets.coco import labels_from_coco, read_coco
from rpl_data.formats.recordings.bop import read_bop

SCENES = ("a", "b", "c")


@pytest.fixture
def scenes(tmp_path):
    found = [two_boxes(tmp_path / "recording", name) for name in SCENES]
    straight = [
        replace(each.scene, intrinsics=replace(each.scene.intrinsics, distortion=())) for each in found
    ]
    return [replace(each, scene=scene) for each, scene in zip(found, straight, strict=True)]


@pytest.fixture
def coco(scenes, tmp_path):
    export_coco(tmp_path / "coco", scenes, [BOX], split=SplitRule(val_fraction=0.0))
    return tmp_path / "coco"


def test_coco_keeps_which_instance_is_which(scenes, coco):
    back = {
        (label.scene, label.frame): [(one.instance, one.mask) for one in label.instances]
        for split in ("train", "test")
        for label in labels_from_coco(read_coco(coco / f"{split}.json"))
    }
    for each in scenes:
        for label in each.labels:
            assert back[label.scene, label.frame] == [(one.instance, one.mask) for one in label.instances]


def test_bop_has_an_entry_per_instance_and_asks_for_all(coco, tmp_path):
    export_bop(tmp_path / "bop", coco, dict.fromkeys(SCENES, 0.001))
    (scene,) = (tmp_path / "bop/test").iterdir()
    truth = json.loads((scene / "scene_gt.json").read_text())
    assert [one["obj_id"] for one in truth[str(LAST_FRAME)]] == [1, 1]
    assert len(list((scene / "mask_visib").glob(f"{LAST_FRAME:06d}_*.png"))) == 2
    targets = json.loads((tmp_path / "bop/test_targets_bop19.json").read_text())
    assert [(one["im_id"], one["inst_count"]) for one in targets] == [
        (n, 2) for n in range(1, LAST_FRAME + 1)
    ]


def test_a_bop_recording_with_two_of_an_object_has_no_truth_for_it(coco, tmp_path):
    export_bop(tmp_path / "bop", coco, dict.fromkeys(SCENES, 0.001))
    for recording in read_bop(tmp_path / "bop" / "test"):
        assert not recording.true_poses
        assert any("more than once" in note for note in recording.notes)


def test_the_others_carry_both(coco, tmp_path):
    export_bundlesdf(tmp_path / "bundle", coco, dict.fromkeys(SCENES, 0.001))
    videos = {
        place.name: len(list((place / "masks").iterdir())) for place in (tmp_path / "bundle/box").iterdir()
    }
    assert videos == {f"{name}{end}": LAST_FRAME for name in SCENES for end in ("", "_instance_2")}
    export_foundationpose(tmp_path / "views", coco, dict.fromkeys(SCENES, 0.001))
    assert check_export(tmp_path / "views", "foundationpose") == []
    assert export_yolo(tmp_path / "yolo", coco).instances == 2 * LAST_FRAME * len(SCENES)
    export_huggingface(tmp_path / "hf", coco)
    last = json.loads((tmp_path / "hf/test/metadata.jsonl").read_text().splitlines()[-1])
    assert last["objects"]["instance"] == ["", "2"]
