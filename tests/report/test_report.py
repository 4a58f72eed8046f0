"""The page stands alone, shows everything, and trusts no name."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest
from pycocotools import mask as coco_mask

from rpl_data.clicks.log import click_event, keypoints_event
from rpl_data.meshes import save_mesh, simplified
from rpl_data.overlay import view_of
from rpl_data.report import write_report
from rpl_data.report.counts import FrameSummary
from rpl_data.report.html import number
from rpl_data.report.pictures import choose_frames
from rpl_data.types import (
    Click,
    ClickResidual,
    Frame,
    FrameLabel,
    InstanceLabel,
    Intrinsics,
    KeypointModel,
    Mesh,
    QualityRow,
    Recording,
    Rle,
    Scene,
    Solution,
    SquareBox,
)
from rpl_data.workspace.workspace import Workspace

CAMERA = Intrinsics(100.0, 100.0, 39.5, 29.5, 80, 60)
NAME = "cup <script>alert(1)</script>"
POINTS = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]])


def instance() -> InstanceLabel:
    mask = np.zeros((60, 80), dtype=np.uint8, order="F")
    mask[20:40, 30:50] = 1
    encoded = coco_mask.encode(mask)
    rle = Rle(size=[60, 80], counts=encoded["counts"].decode())
    box = (30.0, 20.0, 50.0, 40.0)
    pixels = np.array([[31.0, 21.0], [48.0, 38.0], [40.0, 30.0]])
    square = SquareBox(40.0, 30.0, 26.0)
    visibility, sigma_px = np.array([2, 1, 0]), np.array([1.0, 1.0, np.nan])
    return InstanceLabel(
        "cup", np.eye(4), pixels, visibility, sigma_px, square, box, box, rle, rle, 1.0, False, 0.8
    )


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    root = tmp_path_factory.mktemp("report")
    made = Workspace(root / "work")
    cv2.imwrite(str(root / "0.png"), np.full((60, 80, 3), 90, dtype=np.uint8))
    for name in ("near window", "shelf"):
        frames = tuple(Frame(i, i / 30, root / "0.png", None) for i in range(12))
        made.save_recording(Recording(Scene(name, CAMERA, 1e-3, frames), None, ("1 frame without depth: 7",)))
        made.save_labels(name, [FrameLabel(name, i, i / 30, (instance(),) if i else ()) for i in range(12)])
    model = KeypointModel("cup", ("rim", NAME, "foot"), POINTS, ((0, 1),))
    good = ClickResidual(Click("cup", 0, "shelf", 3, 31.0, 21.0), 1.25, 0.002, 0.5, "agrees")
    bad = ClickResidual(
        Click("cup", 1, "shelf", 3, 48.0, 38.0), 41.5, None, None, "rejected", True, "click it again"
    )
    made.save_solution(Solution(model, np.zeros((3, 3, 3)), {}, (good, bad), ("foot was never clicked",)))
    save_mesh(made.mesh_file("cup"), Mesh(POINTS, np.array([[0, 1, 2]])))
    return made


@pytest.fixture(scope="module")
def page(workspace: Workspace) -> str:
    nan = float("nan")
    row = QualityRow(
        "cup", 3, 3, 1.5, 2.5, 9.25, 4.0, 6.0, 0.9, 0.8, nan, nan, nan, nan, 11, 12, missed=1, invented=0
    )
    path = write_report(
        workspace,
        rows=[row],
        timings={"label": {"seconds": 2.0, "frames": 24.0}, "solve": {"seconds": 0.5}},
        split="train 20, val 2 & test 0",
    )
    assert path == workspace.report
    return path.read_text(encoding="utf-8")


class Requests(HTMLParser):
    """Collects what a browser would fetch, and the text of headings."""

    def __init__(self) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.tags: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.fetched += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "data")]


def test_nothing_is_fetched(page: str) -> None:
    parser = Requests()
    parser.feed(page)
    assert parser.tags.count("img") == 16
    assert all(value.startswith(("data:", "#")) for value in parser.fetched)
    style = page[page.index("<style>") : page.index("</style>")]
    assert "@import" not in style and "url(" not in style


def test_every_scene_and_warning_is_there(page: str) -> None:
    for words in ("Scene near window", "Scene shelf", "foot was never clicked", "1 frame without depth: 7"):
        assert words in page
    assert "train 20, val 2 &amp; test 0" in page


def test_how_good_the_labels_are_stands_at_the_top(page: str) -> None:
    assert "<b>2</b><span>scenes</span>" in page and "<b>1</b><span>object</span>" in page
    root_2 = "1.4"  # px: the distance that a deviation of 1 px per axis amounts to
    assert f"<b>{root_2}</b><span>± px expected</span>" in page[: page.index("What to do next")]
    assert f">{root_2}</td>" in page[page.index("Off by") :]
    assert (
        "<code>sigma_px</code>" in page and "`" not in page[page.index("<main>") : page.index('id="objects"')]
    )


def test_names_are_escaped(page: str) -> None:
    assert "<script>alert" not in page
    assert "cup &lt;script&gt;alert(1)&lt;/script&gt;" in page


def test_outliers_stand_out_with_their_reason(page: str) -> None:
    assert re.search(
        r'<tr class="bad"><td>[^<]*</td><td>shelf</td><td>rejected</td><td>click it again</td>', page
    )
    assert page.count('<i class="out"') == 1


def test_quality_is_judged_against_the_paper(page: str) -> None:
    assert '<td class="good">1.50</td>' in page and '<td class="over">9.25</td>' in page
    assert "6.56" in page and "1.94" in page and "0.812" in page


def test_rates_are_frames_over_seconds(page: str) -> None:
    assert '<td class="n">12.0</td>' in page[page.index('id="timings"') :]


def test_plotly_is_put_in_once(page: str) -> None:
    assert page.count("plotly.js v") == 1


def test_a_half_built_workspace_still_has_a_report(tmp_path: Path) -> None:
    empty = Workspace(tmp_path / "w")
    frame = Frame(0, 0.0, tmp_path / "missing.png", None)
    empty.save_recording(Recording(Scene("lonely", CAMERA, 1e-3, (frame,)), None))
    page = write_report(empty).read_text(encoding="utf-8")
    assert "scene lonely has no labels" in page and 'id="timings"' not in page


def test_clicks_are_not_asked_for_in_a_scene_that_has_them(tmp_path: Path) -> None:
    """It was left out of the build, as its recording cannot be read now."""
    made = Workspace(tmp_path / "w")
    for name in ("away", "new"):
        frame = Frame(0, 0.0, tmp_path / "missing.png", None)
        made.save_recording(Recording(Scene(name, CAMERA, 1e-3, (frame,)), None))
    marked = click_event(Click("cup", 0, "away", 0, 1.0, 1.0))
    made.append_events("cup", [keypoints_event(["rim"]), marked])
    made.save_solution(Solution(KeypointModel("cup", ("rim",), POINTS[:1]), np.zeros((1, 3, 3)), {}))
    page = write_report(made).read_text(encoding="utf-8")
    assert "Click keypoints in scene new, which" in page and "scene away has no labels" in page


def test_chosen_frames_are_spread_and_hold_the_worst() -> None:
    frames = [FrameSummary(i, None if i < 10 else 0.4 if i == 33 else 0.9) for i in range(100)]
    chosen, lowest = choose_frames(frames, count=8, worst=1)
    assert len(chosen) == 8 and lowest == {33} and chosen == sorted(chosen)
    assert chosen[0] == 10 and chosen[-1] == 99
    assert choose_frames(frames[:3], count=8, worst=2) == ([0, 1, 2], set())


def test_the_view_holds_the_square_box() -> None:
    wide = Intrinsics(600.0, 600.0, 319.5, 239.5, 640, 480)
    x0, y0, x1, y1 = view_of(FrameLabel("s", 0, 0.0, (instance(),)), wide)
    assert 0 <= x0 <= 27 and x1 >= 53 and 0 <= y0 <= 17 and y1 >= 43
    assert (x1 - x0) / (y1 - y0) == pytest.approx(4 / 3)
    assert view_of(FrameLabel("s", 0, 0.0), wide) == (0, 0, 640, 480)


def test_a_heavy_mesh_is_thinned_for_the_page() -> None:
    grid = np.stack(np.meshgrid(np.linspace(0, 1, 40), np.linspace(0, 1, 40)), axis=-1).reshape(-1, 2)
    vertices = np.column_stack([grid, np.sin(5 * grid[:, 0])])
    first = np.array([40 * r + c for r in range(39) for c in range(39)])
    triangles = np.concatenate(
        [
            np.column_stack([first, first + 1, first + 40]),
            np.column_stack([first + 1, first + 41, first + 40]),
        ]
    )
    assert len(simplified(Mesh(vertices, triangles), most_triangles=500).triangles) <= 500


def test_numbers_are_written_for_people() -> None:
    assert number(12345.678, 1) == "12\u202f345.7"
    assert number(float("nan")) == number(None) == "–"
