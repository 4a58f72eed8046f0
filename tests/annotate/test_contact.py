"""The contact sheet: what is labelled, as pictures, and what a person keeps out of the export."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from annotate_client import client_of
from fastapi.testclient import TestClient

from rpl_data.annotate.stores.pictures import resized
from rpl_data.images import read_color
from rpl_data.overlay import draw_overlay, view_of
from rpl_data.workspace.workspace import Workspace


@pytest.fixture
def client(root: Path) -> TestClient:
    return client_of(root)


def test_every_labelled_frame_is_listed_with_its_worst_quality(client: TestClient, root: Path) -> None:
    found = client.get("/api/labels/01").json()["frames"]
    labels = list(Workspace(root).load_labels("01"))
    assert [item["frame"] for item in found] == [label.frame for label in labels]
    for item, label in zip(found, labels, strict=True):
        assert item["objects"] == [instance.object for instance in label.instances]
        assert item["quality"] == min(round(instance.quality, 4) for instance in label.instances)
        assert item["left_out"] is False
    assert client.get("/api/labels/none").json()["frames"] == []


def test_a_picture_is_the_frame_with_its_labels(client: TestClient, root: Path) -> None:
    workspace = Workspace(root)
    answer = client.get("/api/labels/01/3.jpg?width=300&whole=true")
    shown = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_COLOR_RGB)
    label = next(label for label in workspace.load_labels("01") if label.frame == 3)
    color = read_color(workspace.load_scene("01").frame(3))
    models = {"carton": workspace.load_solution("carton").model}
    expected = resized(draw_overlay(color, label, models, width_px=640), 320)
    assert shown is not None and shown.shape == expected.shape
    off, drawn = (np.abs(image.astype(int) - expected).sum(axis=2) for image in (shown, color))
    marked = drawn > 90
    assert marked.sum() > 500 and (off < drawn / 2)[marked].mean() > 0.95
    assert client.get("/api/labels/01/99.jpg").status_code == 422
    answer = client.get("/api/labels/01/3.jpg?width=300")
    cut = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_COLOR_RGB)
    view = view_of(label, workspace.load_scene("01").intrinsics)
    expected = draw_overlay(color, label, models, view=view, width_px=320)
    assert cut is not None and np.abs(cut.astype(int) - expected).mean() < 4  # JPEG


def test_frames_left_out_stay_out_of_the_export(client: TestClient, root: Path) -> None:
    from rpl_data.pipeline.build import context_of
    from rpl_data.pipeline.exported_labels import export_labels
    from rpl_data.pipeline.stages.export import export_steps

    workspace = Workspace(root)
    before = export_steps(context_of(workspace))[0].options
    for frame in (1, 4, 1):
        answer = client.post("/api/labels/00", json={"frame": frame, "left_out": True})
    assert [item["frame"] for item in answer.json()["frames"] if item["left_out"]] == [1, 4]
    client.post("/api/labels/00", json={"frame": 4, "left_out": False})
    assert client.post("/api/labels/00", json={"frame": 99, "left_out": True}).status_code == 422
    assert export_steps(context_of(workspace))[0].options != before, "the export has to be made again"
    export_labels(context_of(workspace))
    images = [
        (image["scene"], image["frame"])
        for path in workspace.export("coco").glob("*.json")
        for image in json.loads(path.read_text())["images"]
    ]
    assert ("00", 1) not in images and {("00", 0), ("00", 4), ("01", 1)} <= set(images)
    assert len(images) == 17
