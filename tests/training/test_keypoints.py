"""Training programs end to end on a tiny dataset: presets, resuming, checkpoints, bad input, predictions."""

from __future__ import annotations

import csv
import json
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch
from labelled_scenes import BOX, CAMERA, exported

from rpl_data.formats.datasets.bop_results import read_bop_results
from rpl_data.formats.datasets.coco import read_coco, write_coco
from rpl_data.geometry import project
from rpl_data.meshes import save_mesh
from rpl_data.types import DataError, KeypointModel, Mesh
from training.evaluate_pose import evaluate_pose
from training.keypoints.module import load_keypoints, untrained
from training.pose.evaluation import evaluate
from training.pose.pipeline import PosePipeline, SeenKeypoints, load_pipeline, read_depth_like
from training.predict import predict, refuse_no_camera
from training.runs.callbacks import Steps
from training.runs.folder import trained_epochs
from training.runs.options import DetectorNetwork, Learning, Machine, Network
from training.runs.program import main
from training.train_detector import train_detector
from training.train_keypoints import train_keypoints
from training.train_masks import train_masks

CONFIGS = Path(__file__).parents[2] / "training" / "configs"
WEDGE = KeypointModel(
    "wedge",
    ("a", "b", "c", "d", "e"),
    np.array([[-0.1, -0.1, 0], [0.1, -0.1, 0], [0.1, 0.1, 0.08], [-0.1, 0.1, 0.05], [0, 0, -0.08]]),
)
TINY = Network(stacks=1, features=16, levels=2, input_px=32, heatmap_px=8, loss="entropy")
FAST = Learning(epochs=2, batch=4, optimizer="adam", rate=2e-3, schedule="one_cycle", channels_last=True)
ONE = Machine(accelerator="cpu", threads=1)


@pytest.fixture(scope="module")
def coco(tmp_path_factory) -> Path:
    """A wedge in 11 images, 2 of them for validation."""
    folder = tmp_path_factory.mktemp("train")
    return exported(folder, models=(WEDGE,), frames=12, val_fraction=0.2)


@pytest.fixture(scope="module")
def run(coco, tmp_path_factory) -> Path:
    """A finished training."""
    out = tmp_path_factory.mktemp("run")
    many = FAST.epochs + 1  # epochs from one validation to the next: the last one is validated all the same
    train_keypoints(coco, out=out, network=TINY, learning=FAST, machine=ONE, validate_every=many)
    return out


def edited(coco: Path, place: Path, edit) -> Path:
    """A copy of a dataset with its training split changed."""
    shutil.copytree(coco, place)
    data = read_coco(place / "train.json")
    edit(data)
    write_coco(place / "train.json", data)
    return place


def test_run_leaves_checkpoints_and_logs(run):
    assert trained_epochs(run / "last.ckpt") == 2 and (run / "best.ckpt").exists()
    rows = list(csv.DictReader((run / "logs" / "metrics.csv").read_text().splitlines()))
    assert {"train_loss", "val_pck", "val_error", "cpu_s"} <= set(rows[0])
    assert list((run / "logs").glob("events.out.tfevents.*"))


def test_checkpoint_rebuilds_the_network(run):
    loaded = load_keypoints(run / "last.ckpt")
    assert loaded.options == TINY and loaded.model.keypoints == WEDGE.keypoints
    np.testing.assert_array_equal(loaded.model.points_object, WEDGE.points_object)
    weights = torch.load(run / "last.ckpt", weights_only=True)["state_dict"]
    for name, value in loaded.state_dict().items():
        torch.testing.assert_close(value, weights[name])


def test_paper_preset_takes_a_step(coco, tmp_path, capsys):
    arguments = ["--config", str(CONFIGS / "keypoints_paper.yaml"), str(coco), "--out", str(tmp_path)]
    smaller = ["--learning.epochs=1", "--learning.batch=1", "--machine.workers=0", "--validate_every=0"]
    few = edited(coco, tmp_path / "few", keep_one)
    arguments[2] = str(few)
    assert main(train_keypoints, [*arguments, *smaller], presets=True) == 0, capsys.readouterr().err
    trained = load_keypoints(tmp_path / "last.ckpt")
    assert trained.options == Network() and len(trained.network.heads) == 2


def test_a_training_that_validates_nothing_says_that_it_has_no_best(coco, tmp_path, capsys):
    once = replace(FAST, epochs=1)
    train_keypoints(coco, out=tmp_path, network=TINY, learning=once, machine=ONE, validate_every=0)
    assert "there will be last.ckpt and no best.ckpt" in capsys.readouterr().out
    assert not (tmp_path / "best.ckpt").exists()


def keep_one(data) -> None:
    data["annotations"] = data["annotations"][:1]


def test_presets_are_understood():
    from jsonargparse import ArgumentParser

    programs = {"keypoints": train_keypoints, "detector": train_detector, "masks": train_masks}
    for name, program in programs.items():
        for preset in ("cpu", "paper"):
            parser = ArgumentParser()
            parser.add_function_arguments(program)
            path = CONFIGS / f"{name}_{preset}.yaml"
            parsed = parser.parse_path(str(path), defaults=True, _skip_validation=True)
            assert parsed.learning.epochs > 0


# Bad input ----------------------------------------------------------------------------------------


def test_unreadable_image_is_named_skipped_and_counted(coco, tmp_path, capsys):
    place = tmp_path / "coco"
    shutil.copytree(coco, place)
    bad = place / read_coco(place / "train.json")["images"][3]["file_name"]
    bad.unlink()
    bad.write_bytes(b"no image")
    for cache in (False, True):
        train_keypoints(
            place, out=tmp_path / str(cache), network=TINY, learning=FAST, machine=ONE, cache=cache
        )
        said = capsys.readouterr().out
        assert "left out 2 times" in said and bad.name in said
        assert trained_epochs(tmp_path / str(cache) / "last.ckpt") == 2


def test_a_training_that_can_read_nothing_ends(coco, tmp_path):
    place = tmp_path / "coco"
    shutil.copytree(coco, place)
    for image in (place / "images" / "desk").iterdir():
        image.write_bytes(b"no image")
    with pytest.raises(DataError, match=r"no image of epoch 1 could be read.* cannot read the image .*desk"):
        train_keypoints(place, out=tmp_path / "run", network=TINY, learning=FAST, machine=ONE)
    assert not list((tmp_path / "run").glob("*.ckpt"))


@pytest.mark.parametrize("train", [train_keypoints, train_detector, train_masks])
def test_a_training_split_that_shows_nothing_is_refused(coco, tmp_path, train):
    """Every step would leave a loss of nothing, and a network that learned nothing."""

    def unlabel(data) -> None:
        for one in data["annotations"]:
            one |= {"keypoints": [0] * 15, "num_keypoints": 0}
        if train is not train_keypoints:
            data["annotations"] = []

    said = "has a labelled keypoint" if train is train_keypoints else "shows no object"
    with pytest.raises(DataError, match=f"train.json.* {said}.* there is nothing to learn"):
        train(edited(coco, tmp_path / "coco", unlabel), out=tmp_path / "run", machine=ONE)


def test_processes_of_which_none_could_read_an_image_end():
    """Each takes a step of nothing, whose loss is a number all the same."""
    module, reduced = untrained(WEDGE, TINY, FAST), []
    module.unreadable["cannot read the image c.png"] += 1
    strategy = SimpleNamespace(reduce=lambda value, reduce_op: reduced.append(value) or others + value)
    trainer = SimpleNamespace(is_last_batch=True, current_epoch=0, strategy=strategy)
    nothing, step = (None, ("cannot read the image c.png",)), {"loss": torch.tensor(0.0)}
    others = torch.tensor(1.0)
    Steps(FAST, 0).on_train_batch_end(trainer, module, step, nothing, 0)
    others = torch.tensor(0.0)
    with pytest.raises(DataError, match="no image of epoch 1 could be read.*c.png"):
        Steps(FAST, 0).on_train_batch_end(trainer, module, step, nothing, 0)
    assert reduced == [0, 0]
    Steps(FAST, 0).on_train_batch_end(trainer, module, step, ({"image": torch.ones(1)}, ()), 0)


def test_instances_without_a_labelled_keypoint_are_not_judged(monkeypatch):
    """The mean over none would be NaN, and with it that of the epoch, so that no best would be kept."""
    module, logged = untrained(WEDGE, TINY, FAST).eval(), []
    monkeypatch.setattr(module, "log_validated", lambda name, value, **_: logged.append((name, float(value))))
    batch = {"image": torch.zeros(1, 3, 32, 32), "heatmaps": torch.zeros(1, 5, 8, 8)}
    batch |= {"weights": torch.zeros(1, 5), "keypoints_px": torch.full((1, 5, 2), torch.nan)}
    batch |= {"crop_from_image": torch.eye(3)[None, :2], "square_box": torch.ones(1, 3)}
    with torch.no_grad():
        module.validation_step((batch, ()), 1)
    assert logged == [("loss", 0.0)]


def test_loss_that_is_no_number_names_the_batch(coco, tmp_path):
    module = untrained(WEDGE, TINY, FAST)
    batch = {"image": torch.full((2, 3, 32, 32), torch.nan), "heatmaps": torch.zeros(2, 5, 8, 8)}
    batch |= {"weights": torch.ones(2, 5), "image_id": torch.tensor([7, 9])}
    with pytest.raises(DataError, match=r"epoch 1, batch 5, images 7, 9 .*the loss is nan"):
        module.training_step((batch, ()), 4)


def test_dataset_without_keypoints(coco, tmp_path):
    def edit(data):
        data["categories"][0] |= {"keypoints": [], "skeleton": []}
        data["rpl"]["objects"][0]["points_object"] = []
        for annotation in data["annotations"]:
            annotation |= {"keypoints": [], "num_keypoints": 0, "sigma_px": []}

    place = edited(coco, tmp_path / "coco", edit)
    with pytest.raises(DataError, match="wedge has no keypoints"):
        train_keypoints(place, out=tmp_path, network=TINY, learning=FAST, machine=ONE)


def test_object_never_visible_and_empty_splits(coco, tmp_path):
    place = edited(coco, tmp_path / "coco", lambda data: data.update(annotations=[]))
    with pytest.raises(DataError, match="no instance of wedge"):
        train_keypoints(place, out=tmp_path, network=TINY, learning=FAST, machine=ONE)
    empty = edited(coco, tmp_path / "empty", lambda data: data.update(annotations=[], images=[]))
    with pytest.raises(DataError, match="no image"):
        train_detector(empty, out=tmp_path, learning=FAST, machine=ONE)
    shutil.copy(coco / "train.json", empty / "train.json")
    data = read_coco(empty / "val.json")
    write_coco(empty / "val.json", data | {"images": [], "annotations": []})
    train_keypoints(empty, out=tmp_path / "unvalidated", network=TINY, learning=FAST, machine=ONE)
    assert not (tmp_path / "unvalidated" / "best.ckpt").exists()


def test_one_keypoint(coco, tmp_path):
    def edit(data):
        data["categories"][0] |= {"keypoints": ["a"], "skeleton": []}
        data["rpl"]["objects"][0]["points_object"] = data["rpl"]["objects"][0]["points_object"][:1]
        for a in data["annotations"]:
            a |= {"keypoints": a["keypoints"][:3], "sigma_px": a["sigma_px"][:1]}
            a["num_keypoints"] = int(a["keypoints"][2] > 0)

    place = edited(coco, tmp_path / "coco", edit)
    (place / "val.json").unlink()
    train_keypoints(place, out=tmp_path, network=TINY, learning=FAST, machine=ONE)
    assert load_keypoints(tmp_path / "last.ckpt").network.heads[0].out_channels == 1


def test_checkpoints_of_something_else(coco, run, tmp_path):
    with pytest.raises(DataError, match="there is no checkpoint .* train one with `rpl train keypoints`"):
        load_keypoints(tmp_path / "last.ckpt")
    (tmp_path / "last.ckpt").touch()
    with pytest.raises(DataError, match=r"the run has \S+last.ckpt so far"):
        load_keypoints(tmp_path / "best.ckpt")
    (tmp_path / "last.ckpt").unlink()
    (tmp_path / "no.ckpt").write_bytes(b"no checkpoint")
    with pytest.raises(DataError, match="as a checkpoint of .*: it is damaged, or something else"):
        load_keypoints(tmp_path / "no.ckpt")
    other = Network(stacks=1, features=32, levels=2, input_px=32, heatmap_px=8, loss="entropy")
    with pytest.raises(DataError, match="resume with the options"):
        train_keypoints(coco, out=run, network=other, learning=FAST, machine=ONE, resume=True)

    def four(data):
        data["categories"][0]["keypoints"] = data["categories"][0]["keypoints"][:4]
        data["rpl"]["objects"][0]["points_object"] = data["rpl"]["objects"][0]["points_object"][:4]
        for a in data["annotations"]:
            a |= {"keypoints": a["keypoints"][:12], "sigma_px": a["sigma_px"][:4]}
            a["num_keypoints"] = sum(v > 0 for v in a["keypoints"][2::3])

    place = edited(coco, tmp_path / "four", four)
    (place / "val.json").unlink()
    with pytest.raises(DataError, match="with 5 keypoints .* with 4"):
        train_keypoints(place, out=run, network=TINY, learning=FAST, machine=ONE, resume=True)


def test_mistakes_are_one_line(tmp_path, capsys):
    assert main(train_keypoints, [str(tmp_path / "none"), "--out", str(tmp_path)]) == 1
    said = capsys.readouterr().err
    assert said.startswith("train_keypoints: ") and said.count("\n") == 1
    with pytest.raises(DataError, match="a quarter"):
        untrained(WEDGE, Network(input_px=100), FAST)


# What is done with them ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def detector(coco, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("detector")
    network = DetectorNetwork(width_px=96, features=32)
    return train_detector(coco, out=out, network=network, learning=FAST, machine=ONE)


def test_one_checkpoint_needs_no_list(tmp_path, capsys):
    cv2.imwrite(str(tmp_path / "photo.png"), np.zeros((4, 4, 3), np.uint8))
    for given in ("lone.ckpt", "[lone.ckpt, other.ckpt]"):
        assert main(predict, [str(tmp_path), "--keypoints", given, "--camera", "[9, 9, 2, 2]"]) == 1
        assert "there is no checkpoint lone.ckpt" in capsys.readouterr().err


def test_predictions(coco, run, detector, tmp_path):
    camera = [CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy]
    (tmp_path / "in" / "desk").mkdir(parents=True)
    for image in sorted((coco / "images" / "desk").iterdir())[:2]:
        shutil.copy(image, tmp_path / "in" / "desk" / image.name)
    (tmp_path / "in" / "desk" / "000099.png").write_bytes(b"broken")
    clicks = tmp_path / "clicks.csv"
    predict(tmp_path / "in", [run / "last.ckpt"], detector, camera, out=tmp_path / "out", clicks=clicks)
    entries = json.loads((tmp_path / "out" / "poses.json").read_text())
    assert len(entries) == 2
    for entry in entries:
        for found in entry["objects"]:
            assert (found["camera_from_object"] is None) == (found["failure"] is not None)
            assert len(found["keypoints_px"]) == 5
    assert len(list((tmp_path / "out" / "overlays").rglob("*.jpg"))) == 2
    assert clicks.read_text().startswith("object,keypoint,scene,frame,u_px,v_px")
    with pytest.raises(DataError, match="holds no image"):
        predict(tmp_path / "out" / "overlays" / "none", [run / "last.ckpt"], detector, camera)
    (tmp_path / "damaged.png").write_bytes(b"no image")
    with pytest.raises(DataError, match="every image was left out; the first: .*damaged.png"):
        predict(tmp_path / "damaged.png", [run / "last.ckpt"], detector, camera, out=tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_a_bar_says_how_far_predictions_and_scores_are(coco, run, detector, tmp_path, capsys, monkeypatch):
    with_mesh(coco, tmp_path)
    camera = [CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy]
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setattr("rich._console", None)  # it remembers whether it writes on a terminal
    image = min((coco / "images" / "desk").iterdir())
    predict(image, run / "last.ckpt", detector, camera, out=tmp_path / "out", overlays=False)
    assert re.search(f"{image.name} .*100%", capsys.readouterr().out)
    evaluate_pose(tmp_path, run / "last.ckpt", split="train", crops="given", methods=["epnp"])
    assert re.search("train.json .*100%", capsys.readouterr().out)


@pytest.mark.parametrize(("camera", "distortion", "unit", "said"), [
    ([0.0, 150.0, 80.0, 60.0], [], 0.001, "focal lengths are above 0"),
    ([150.0, 150.0, np.nan, 60.0], [], 0.001, "--camera is"),
    ([150.0] * 4, [0.1, 0.2, 0.3], 0.001, "4, 5, 8, 12 or 14"),
    ([150.0] * 4, [], -1.0, "above 0: 0.001 for millimetres"),
])  # fmt: skip
def test_what_is_no_camera_is_refused(camera, distortion, unit, said):
    with pytest.raises(DataError, match=said):
        refuse_no_camera(camera, distortion, unit)


def test_crops_that_nobody_finds_are_refused(tmp_path):
    with pytest.raises(DataError, match="give --detector, .* by --crops given"):
        evaluate_pose(tmp_path, tmp_path / "none.ckpt")


def with_mesh(coco: Path, place: Path) -> None:
    """Put a training split whose first object has a mesh into a folder; images stay where they are."""
    corners = np.random.default_rng(0).uniform(-0.1, 0.1, (51, 3))
    save_mesh(place / "mesh.ply", Mesh(corners, np.arange(51).reshape(-1, 3)))
    data = read_coco(coco / "train.json")
    data["rpl"]["objects"][0]["mesh"] = "mesh.ply"
    write_coco(place / "train.json", data)
    (place / "images").symlink_to(coco / "images")
    (place / "depth").symlink_to(coco / "depth")


def test_evaluation_counts_what_is_missing(coco, run, detector, tmp_path, capsys):
    with_mesh(coco, tmp_path)
    data = read_coco(coco / "train.json")
    for crops in ("given", "detected"):
        out = tmp_path / crops
        evaluate_pose(
            tmp_path, [run / "last.ckpt"], detector, split="train", crops=crops, out=out, bop=True,
            depth=crops == "given",
        )  # fmt: skip
        found = json.loads((out / "train_poses.json").read_text())
        figures = found["figures"]["wedge consensus"]
        assert figures["instances"] == len(data["annotations"]) and len(found["instances"]) == 2 * len(
            data["annotations"]
        )
        failed = [e for e in found["instances"] if e["found"] != "ok"]
        assert all(e["position_m"] is None for e in failed)
        assert figures["failures"] == sum(e["method"] == "consensus" for e in failed)
        assert figures["bop"]["average_recall"] is not None  # the export says the unit of its depth
        poses = read_bop_results(out / "consensus_rpl-train.csv")
        assert len(poses) == figures["instances"] - figures["failures"]
    shutil.copy(tmp_path / "train.json", tmp_path / "test.json")  # tested on now, after it was trained on
    assert "was trained on" not in capsys.readouterr().out
    evaluate_pose(tmp_path, [run / "last.ckpt"], crops="given", methods=["epnp"], depth=False)
    (scene,) = {image["scene"] for image in data["images"]}
    assert f"{run / 'last.ckpt'} was trained on scene {scene}" in capsys.readouterr().out


def test_an_object_without_a_network_needs_no_mesh(run, tmp_path, capsys):
    """Views of an object that stood still in no training scene are not rendered, nor is its mesh exported."""
    both = exported(tmp_path / "both", models=(WEDGE, BOX), frames=3)
    (tmp_path / "meshes").mkdir()
    with_mesh(both, tmp_path / "meshes")
    wished = {"split": "train", "crops": "given"}
    evaluate_pose(tmp_path / "meshes", run / "last.ckpt", methods=["epnp", "epnp"], **wished)
    said = capsys.readouterr().out
    assert said.count("2 instances") == 1 and "depth" not in said  # once each, and EPnP uses no depth
    data = read_coco(tmp_path / "meshes" / "train.json")
    data["rpl"]["objects"][0]["mesh"] = None
    write_coco(tmp_path / "meshes" / "train.json", data)
    with pytest.raises(DataError, match="wedge has no mesh"):
        evaluate_pose(tmp_path / "meshes", run / "last.ckpt", **wished)
    with pytest.raises(DataError, match="--methods names none"):
        evaluate_pose(tmp_path / "meshes", run / "last.ckpt", methods=[], **wished)


def test_a_detector_that_does_not_know_the_object_is_refused(run, detector, tmp_path):
    content = torch.load(detector, weights_only=True)
    content["hyper_parameters"]["names"] = ["background", "box"]
    torch.save(content, tmp_path / "other.ckpt")
    with pytest.raises(DataError, match=r"other\.ckpt: the detector does not know wedge"):
        load_pipeline([run / "last.ckpt"], tmp_path / "other.ckpt")


def test_evaluation_refuses_another_objects_dataset(run, tmp_path):
    pipeline = load_pipeline([run / "last.ckpt"])
    other = exported(tmp_path, models=(BOX,), frames=4) / "train.json"
    with pytest.raises(DataError, match="has no wedge, which a checkpoint is of; it has box"):
        next(evaluate(pipeline, other, crops="given", methods=["epnp"], truth={"box": None}))


def test_depth_is_read_in_metres_or_refused(tmp_path):
    color = np.zeros((4, 6, 3), dtype=np.uint8)
    depth = np.arange(24, dtype=np.uint16).reshape(4, 6)
    cv2.imwrite(str(tmp_path / "depth.png"), depth)
    np.testing.assert_allclose(
        read_depth_like(tmp_path / "depth.png", 0.002, like=color), 0.002 * depth, rtol=1e-6
    )
    with pytest.raises(DataError, match="registered to colour"):
        read_depth_like(tmp_path / "depth.png", 0.001, like=color[:2])
    with pytest.raises(DataError, match="nothing readable"):
        read_depth_like(tmp_path / "none.png", 0.001, like=color)


def test_depth_pins_a_predicted_distance(run):
    """Keypoints seen from a pose, the object's size wrong by a tenth: depth tells where it is."""
    network = load_keypoints(run / "last.ckpt")
    intrinsics = replace(CAMERA, distortion=())
    seen_px = project(intrinsics, WEDGE.points_object * 1.1 + [0, 0, 1.1])
    tight = np.tile(4 * np.eye(2), (5, 1, 1))
    seen = SeenKeypoints("wedge", np.array([80.0, 60, 40]), 1.0, seen_px, np.ones(5), tight)
    pipeline = PosePipeline({"wedge": network})
    depth = np.full((CAMERA.height, CAMERA.width), 1.1, dtype=np.float32)
    without = pipeline.pose(seen, intrinsics).camera_from_object[2, 3]
    with_depth = pipeline.pose(seen, intrinsics, depth=depth).camera_from_object[2, 3]
    assert without == pytest.approx(1.0, abs=0.01)
    assert abs(with_depth - 1.1) < abs(without - 1.1) / 2
