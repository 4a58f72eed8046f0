"""The experiments end to end on the tiny workspace, and the laws their numbers keep."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from html import unescape
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from rpl_data.command_line import parser_of
from rpl_data.formats.models.meshlab import write_picked_points
from rpl_data.geometry import fit_rigid, transform
from rpl_data.meshes import load_mesh, save_mesh
from rpl_data.pipeline.build import recipe_of
from rpl_data.types import Click, DataError
from rpl_data.workspace.workspace import Workspace
from training.reproduce.__main__ import COMMANDS, main
from training.reproduce.all_experiments import PRESETS, TrainingOptions, command_lines, run_all
from training.reproduce.curves import resample
from training.reproduce.curves.slopes import before_the_fit, slope_of
from training.reproduce.results import finite_or_none, write_results
from training.reproduce.table1.baseline import nearest_measuring
from training.reproduce.table1.cad_protocol import by_cad, true_cads
from training.reproduce.table1.experiment import measure
from training.reproduce.table1.page import write_page
from training.reproduce.table1.rows import Row
from training.reproduce.table1.worst import worst_scenes
from training.runs.presets import with_preset_files
from training.runs.program import INTERRUPTED

ROOT = Path(__file__).parents[2]


def test_help_is_quick_and_lists_every_command() -> None:
    code = (
        "import sys; from training.reproduce.__main__ import COMMANDS; "
        "heavy = {'torch', 'open3d', 'matplotlib', 'cv2'} & set(sys.modules); assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
    assert all((command.__doc__ or "").strip() for command in COMMANDS.values())


def rows_of(out: Path) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = json.loads((out / "table1.json").read_text())["rows"]
    return rows


@pytest.fixture(scope="module")
def whole(tiny_workspace: Workspace) -> Row:
    """What table 1 says of the tiny workspace."""
    (row,) = measure(tiny_workspace)
    return row


def test_table1_of_a_workspace(tiny_workspace: Workspace, tmp_path: Path) -> None:
    assert main(["table1", str(tiny_workspace.root), "--out", str(tmp_path)]) == 0
    (row,) = rows_of(tmp_path)
    model = tiny_workspace.load_solution("carton").model
    assert (row["object"], row["keypoints"], row["scenes"]) == ("carton", len(model.keypoints), 3)
    frames = [label for scene in tiny_workspace.scene_names() for label in tiny_workspace.load_labels(scene)]
    assert row["labels"] == len(frames)
    assert 0 < row["by_cad"]["error_3d_mm"] < row["strict"]["error_3d_mm"] < 5  # closest points flatter
    assert row["cad_rms_mm"] < 3 and row["started_by_solution"] == 0
    assert row["by_cad"]["iou"] == pytest.approx(row["strict"]["iou"], abs=0.05)
    worst = row["worst"]
    assert worst["scene"] in tiny_workspace.scene_names() and 3 <= worst["clicked"] <= row["keypoints"]
    assert row["strict"]["error_2d_px"] < worst["error_2d_px"] < 5 and 0.5 < worst["iou"] < 1
    assert f"carton, scene {worst['scene']}: " in (tmp_path / "table1.html").read_text()
    paper, careful = row["paper"], row["careful"]
    assert row["strict"]["error_3d_mm"] < careful["error_3d_mm"] < paper["error_3d_mm"]
    assert paper["iou"] < careful["iou"] < row["strict"]["iou"]
    beside = tmp_path / "workspaces" / f"{tiny_workspace.root.name}_given_baseline"
    papers = recipe_of(Workspace(beside / "paper"))
    assert (papers.solve.method, papers.segment.method, papers.label.method) == ("slsqp", "smooth", "splat")


def test_a_careful_click_goes_to_the_nearest_pixel_that_measures_its_keypoint() -> None:
    depth_m = np.full((60, 80), 0.9, np.float32)
    depth_m[:, 40:] = 0.7
    click = Click("carton", 0, "00", 0, 36.3, 20.2)
    assert nearest_measuring(depth_m, click, 0.9) == (36.3, 20.2)
    assert nearest_measuring(depth_m, click, 0.7) == (40.0, 20.0)
    assert nearest_measuring(depth_m, click, 0.8) is None
    assert nearest_measuring(depth_m, replace(click, u_px=20.0), 0.7) is None


def test_drifting_trajectories_cost_accuracy_and_are_reproduced(
    tiny_workspace: Workspace, whole: Row, tmp_path: Path
) -> None:
    command = ["table1", str(tiny_workspace.root), "--out", str(tmp_path), "--workers", "1"]
    command += ["--baseline", "false", "--trajectories", "[drifting]"]
    assert main(command) == 0
    (drifting,) = rows_of(tmp_path)
    assert drifting["trajectories"] == "drifting" and drifting["labels"] == whole.labels
    assert drifting["strict"]["error_2d_px"] > whole.strict.error_2d_px
    stages = tmp_path / "workspaces" / f"{whole.workspace}_drifting"
    before = (stages / "stages.json").read_text()
    assert main(command) == 0
    assert rows_of(tmp_path) == [drifting]
    assert (stages / "stages.json").read_text() == before  # nothing was built again


def test_a_cad_of_ones_own_stands_for_truth(tiny_workspace: Workspace, whole: Row, tmp_path: Path) -> None:
    """The true mesh in millimetres with picked points beside it, as a real recording would have it."""
    truth = Workspace(tiny_workspace.truth)
    model, mesh = truth.load_solution("carton").model, load_mesh(truth.mesh_file("carton"))
    save_mesh(tmp_path / "cad" / "carton.ply", replace(mesh, vertices=1e3 * mesh.vertices))
    write_picked_points(tmp_path / "cad" / "carton.pp", model.keypoints, 1e3 * model.points_object)
    rows = measure(tiny_workspace, cad_folder=tmp_path / "cad", metres_per_unit=0.001)
    (own,) = rows
    assert own.by_cad is not None and whole.by_cad is not None
    assert own.by_cad.error_2d_px == pytest.approx(whole.by_cad.error_2d_px, abs=0.3)
    with pytest.raises(DataError, match="has a CAD for none of carton"):
        measure(tiny_workspace, cad_folder=tmp_path)
    (tmp_path / "cad" / "carton.pp").unlink()
    with pytest.raises(DataError, match="has no picked points"):
        measure(tiny_workspace, cad_folder=tmp_path / "cad")


def test_a_scene_whose_surface_lost_the_object_is_left_out_and_named(
    tiny_workspace: Workspace, whole: Row, tmp_path: Path
) -> None:
    shutil.copytree(tiny_workspace.root, tmp_path / "copy")
    changed = Workspace(tmp_path / "copy")
    name = changed.scene_names()[1]
    surface = load_mesh(changed.surface_file(name))
    save_mesh(changed.surface_file(name), replace(surface, vertices=surface.vertices + [0.0, 0.0, 1.0]))
    (row,) = measure(changed)
    assert len(row.left_out) == 1 and row.left_out[0].startswith(f"{name}: object carton: only")
    assert row.strict == whole.strict and row.by_cad is not None
    assert "Not judged by CAD" in write_page(tmp_path, [row], seed=0).read_text()


def test_a_recording_that_was_cut_is_judged_like_the_whole(tiny_workspace: Workspace, tmp_path: Path) -> None:
    """Both parts stand as the whole did, so every label is as good as before."""
    shutil.copytree(tiny_workspace.root, tmp_path / "copy", symlinks=True)
    changed = Workspace(tmp_path / "copy")
    video = changed.scene_names()[0]
    frames = [frame.index for frame in changed.load_scene(video).frames]
    middle = len(frames) // 2
    changed.cut_scene(video, [(frames[0], frames[middle]), (frames[middle + 1], frames[-1])])
    solution = changed.load_placed("carton")
    places = dict(solution.scene_from_object)
    standing = places.pop(video)
    for part in changed.parts().scenes_of(video):
        places[part] = standing
        shutil.copyfile(changed.surface_file(video), changed.surface_file(part))
    changed.save_solution(replace(solution, scene_from_object=places))
    changed.remove_refined("carton")
    cads = true_cads(Workspace(tiny_workspace.truth), ["carton"], seed=0)
    whole, cut = (by_cad(place, cads)["carton"].row for place in (tiny_workspace, changed))
    assert cut.frames == whole.frames  # none is left out
    assert cut.error_2d_mean_px == pytest.approx(whole.error_2d_mean_px, abs=0.3)
    worst = worst_scenes(changed, Workspace(tiny_workspace.truth))["carton"]
    assert worst == worst_scenes(tiny_workspace, Workspace(tiny_workspace.truth))["carton"]


def test_a_folder_that_is_no_workspace_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["table1", str(tmp_path), "--out", str(tmp_path / "out")]) == 1
    assert "is not a workspace" in capsys.readouterr().err


def test_results_hold_no_nan(tmp_path: Path) -> None:
    page = write_results(tmp_path, "x", title="<X>", data={"a": [float("nan"), 1.0]}, sections=["body"])
    assert json.loads((tmp_path / "x.json").read_text()) == {"a": [None, 1.0]}
    assert "&lt;X&gt;" in page.read_text()
    assert finite_or_none({"t": (1, float("inf"))}) == {"t": [1, None]}


# All ----------------------------------------------------------------------------------------------


def test_all_experiments_go_on_where_they_were(tmp_path: Path) -> None:
    """One fails and is tried again, the others are not; a changed command runs anew; one page shows them."""
    ran: list[str] = []

    def run(command: list[str]) -> int:
        name = command[0]
        ran.append(name)
        if name == "curves" and ran.count("curves") == 1:
            return 1
        if name == "segmentation" and ran.count("segmentation") == 1:
            raise MemoryError  # a fault of one experiment ends no other
        write_results(tmp_path / name, name, title=name, data={}, sections=[f"<p>body of {name}</p>"])
        return 0

    options: dict[str, Any] = {"workers": 1}
    quick = TrainingOptions("scratch", seeds=1, precision="bf16-mixed")
    given = PRESETS["cpu"], tmp_path / "ws", ["drill", "cup"], tmp_path
    commands = command_lines(*given, quick, **options)
    assert run_all(commands, tmp_path, run) == ["curves", "segmentation"]
    page = (tmp_path / "all.html").read_text()
    assert "failed" in page and "body of table2" in page and "body of curves" not in page
    assert "'[drill, cup]'" in unescape(page)  # a command line that a shell takes as it is
    with pytest.raises(SystemExit):
        run_all({"ablation": ["ablation"]}, tmp_path, lambda command: INTERRUPTED)
    assert run_all(commands, tmp_path, run) == []
    assert run_all(command_lines(*given, replace(quick, seeds=2), **options), tmp_path, run) == []
    assert ran == [*commands, "curves", "segmentation", "table2"]
    assert "body of curves" in (tmp_path / "all.html").read_text()
    parser = parser_of(COMMANDS, program="reproduce", description="", presets=[COMMANDS["table2"]])
    assert commands["segmentation"][6:] == [
        "--precision",
        "bf16-mixed",
        "--out",
        str(tmp_path / "segmentation"),
    ]
    for command in commands.values():  # it ends the test where it does not understand one
        parser.parse_args(with_preset_files(command))


# Ablation -----------------------------------------------------------------------------------------


def test_ablation_of_a_workspace(
    tiny_workspace: Workspace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["ablation", str(tiny_workspace.root), "--out", str(tmp_path), "--workers", "1"]
    assert main([*command, "--parts", "[papers_masks]"]) == 0
    data = json.loads((tmp_path / "ablation.json").read_text())
    whole, splat = data["rows"]["all"][0], data["rows"]["papers_masks"][0]
    assert whole["error_2d_mean_px"] == splat["error_2d_mean_px"]  # the poses are the same
    assert splat["iou_full_mean"] < whole["iou_full_mean"]
    lines = {line.split()[0]: line.split()[1:] for line in capsys.readouterr().out.splitlines()}
    assert lines["building"] and lines["label"][-1] == "frames"  # what is built meanwhile, step by step
    assert lines["papers_masks"][4:6] == ["+0.00", "+0.00"] and lines["papers_masks"][7].startswith("-0.")
    assert main([*command, "--parts", "[refining]"]) == 1
    assert "there is no part 'refining'" in capsys.readouterr().err


# Error curves -------------------------------------------------------------------------------------


def test_a_falling_and_a_flat_curve_are_told_apart() -> None:
    rng = np.random.default_rng(0)
    x = np.arange(2.0, 11.0)
    noise = 0.3 * rng.standard_normal((12, 9))
    falling, flat = slope_of(x, 3 - 0.15 * x + noise), slope_of(x, 2 + noise)
    assert falling.falls and not falling.flat
    assert flat.flat and not flat.falls
    assert falling.low < -0.15 * 8 < falling.high
    assert falling.change == pytest.approx(-1.2, abs=0.3)
    assert flat.spread == pytest.approx(0.3, abs=0.05)


def test_the_rigid_fit_hides_the_share_of_the_error_that_is_given_back() -> None:
    rng = np.random.default_rng(0)
    keypoints = np.array([5.0, 8.0, 12.0])
    points = 0.1 * rng.standard_normal((12, 3))
    errors_mm = np.empty((400, 3))
    for seed, column in np.ndindex(errors_mm.shape):
        true = points[: int(keypoints[column])]
        model = true + 0.001 * rng.standard_normal(true.shape)
        fitted = transform(fit_rigid(true, model), model)
        errors_mm[seed, column] = 1e3 * np.linalg.norm(fitted - true, axis=1).mean()
    assert slope_of(keypoints, errors_mm).low > 0.05  # few look better than many
    freed = before_the_fit(keypoints, errors_mm).mean(axis=0)
    np.testing.assert_allclose(freed, np.sqrt(8 / np.pi), rtol=0.04)  # the mean length of such an error


def test_seeds_without_an_answer_are_left_out_of_the_means() -> None:
    x = np.array([1.0, 2.0, 3.0])
    y = np.array([[1.0, 2.0, 3.0], [np.nan, 2.0, 3.0], [1.0, np.nan, 3.0]])
    assert slope_of(x, y).change == pytest.approx(2.0)


def test_curves_of_a_workspace(
    tiny_workspace: Workspace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keypoints = len(tiny_workspace.load_solution("carton").model.keypoints)
    monkeypatch.setattr(resample, "LEAST_KEYPOINTS", keypoints - 1)  # two places on the curve are enough
    command = ["curves", "--workspace", str(tiny_workspace.root), "--seeds", "2", "--click_noise_px", "1"]
    assert main([*command, "--out", str(tmp_path / "a")]) == 0
    data = json.loads((tmp_path / "a" / "curves.json").read_text())
    by = {curve["against"]: curve for curve in data["curves"]}
    assert by["scenes"]["x"] == [2, 3] and by["keypoints"]["x"] == [keypoints - 1, keypoints]
    errors = [e for curve in data["curves"] for row in curve["error_mm"] for e in row if e is not None]
    assert errors and all(0 < e < 20 for e in errors)
    for name in ("curves_keypoints.png", "curves_scenes.png"):
        assert cv2.imread(str(tmp_path / "a" / name)).std() > 10  # a drawing, not an empty page
    assert main([*command, "--out", str(tmp_path / "b")]) == 0
    for name in ("curves.json", "curves.html", "curves_scenes.png"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_curves_need_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["curves", "--workspace", str(tmp_path), "--out", str(tmp_path / "out")]) == 1
    assert "is no built twin" in capsys.readouterr().err
