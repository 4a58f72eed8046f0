"""`rpl_data`: what it offers, how quickly, and that paths may be text everywhere."""

from __future__ import annotations

import ast
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
import yaml

import rpl_data
from rpl_data.pipeline.build import Progress
from rpl_data.types import DataError
from rpl_data.workspace.workspace import Workspace

ROOT = Path(__file__).parents[1]
DOORS = ["rpl_data", "rpl_data.torch"]


@pytest.mark.parametrize("door", DOORS)
def test_importing_it_loads_nothing_heavy(door: str) -> None:
    heavy = ["numpy", "cv2", "open3d", "scipy", "torch", "jsonargparse"]
    program = f"import {door}, sys; dir({door}); print([name for name in {heavy} if name in sys.modules])"
    ran = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert ran.stdout.strip() == "[]"


@pytest.mark.parametrize("door", DOORS)
def test_every_name_is_there_and_nothing_else_is_offered(door: str) -> None:
    module = import_module(door)
    assert dir(module) == sorted(module.__all__) == list(module.__all__)
    assert all(getattr(module, name) is not None for name in module.__all__)
    assert dir(module) == sorted(module.__all__), "names that were loaded stay out of completion"
    with pytest.raises(AttributeError, match=f"module '{door}' has no attribute 'nothing'"):
        module.nothing  # noqa: B018


@pytest.mark.parametrize("door", DOORS)
def test_type_checkers_see_what_is_loaded(door: str) -> None:
    """The imports that only a type checker runs are those that __getattr__ makes."""
    module = import_module(door)
    assert module.__file__ is not None
    (checked,) = [
        node
        for node in ast.parse(Path(module.__file__).read_text()).body
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    ]
    seen = {
        alias.asname: node.module
        for node in checked.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert seen == module._MODULE_OF
    assert set(module.__all__) - {"__version__"} == seen.keys()


def test_a_recipe_file_is_built_in_one_call(tiny_workspace: Workspace, tmp_path: Path) -> None:
    """Its path and the workspace's may be text; what was built by a path holds for the text."""
    recipe = _recipe_of(tiny_workspace, tmp_path)
    workspace = rpl_data.build(recipe, workspace=tmp_path / "ws", until="solve", workers=1)
    assert repr(workspace).endswith("3 scenes with 18 frames, 1 object (carton), 0 labelled frames")
    assert workspace.model("carton").points_object.shape == (11, 3)
    told: list[Progress] = []
    same = rpl_data.build(str(recipe), workspace=str(tmp_path / "ws"), until="solve", tell=told.append)
    assert repr(same) == repr(workspace) and {item.state for item in told} == {"kept"}
    for path in (recipe, str(recipe)):
        told.clear()
        rpl_data.build(rpl_data.load_recipe(path), workspace, until="solve", again="solve", tell=told.append)
        assert {item.stage for item in told if item.state == "ran"} == {"solve"}
        assert {item.stage for item in told if item.state == "kept"} >= {"import", "clicks"}
        assert "import: up to date" in map(str, told)


def test_relative_paths_start_at_the_root_given(tiny_workspace: Workspace, tmp_path: Path) -> None:
    recipe = _recipe_of(tiny_workspace, tmp_path, path="recording", clicks="recording/clicks.csv")
    workspace = rpl_data.build(recipe, tmp_path / "ws", root=str(tiny_workspace.root), until="import")
    assert workspace.scene_names() == ["00", "01", "02"]
    with pytest.raises(DataError, match="give it to `load_recipe`"):
        rpl_data.build(rpl_data.load_recipe(recipe), workspace, root=tmp_path)


@pytest.mark.parametrize("options", [{"again": "solv"}, {"again": ["solve", "solv"]}, {"until": "solv"}])
def test_a_stage_that_is_none_is_refused(tmp_path: Path, options: dict[str, str]) -> None:
    with pytest.raises(DataError, match=r"no stage 'solv'; the stages are twin, import, .*report"):
        rpl_data.build(tmp_path / "any.yaml", tmp_path, **options)


def _recipe_of(workspace: Workspace, folder: Path, **paths: str) -> Path:
    """A recipe file that takes the recording of a twin as if it were anybody's."""
    recording = workspace.recording
    content = {
        "name": "carton",
        "scenes": [{"path": paths.get("path", str(recording))}],
        "objects": [{"name": "carton", "keypoints": list(workspace.model("carton").keypoints)}],
    }
    content["objects"][0]["clicks"] = paths.get("clicks", str(recording / "clicks.csv"))
    path = folder / "carton.yaml"
    path.write_text(yaml.safe_dump(content))
    return path
