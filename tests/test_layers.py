"""The layers of the package: imports go only downwards, and stages never import one another."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
STAGES = {
    "annotate", "cad", "capture", "doctor", "export", "label", "quality", "reconstruct", "refine", "report",
    "segment", "solve", "truth", "twin",
}  # fmt: skip
LAYERS = [
    {"types"},
    {"clicklog", "depth_codec", "files", "geometry", "records"},
    {"masks", "mend", "parts", "pixels", "regions", "reprojection", "split", "surface_files"},
    {
        "adjustment", "completion", "drift", "formats", "grasp", "lift", "occlusion", "overlay", "pool",
        "pose", "raycast", "simplify", "steps", "views", "workspace",
    },
    STAGES,
    {"recipe", "torch"},
    {"pipeline"},
    {"build"},
    {"record", "screen", "serve"},
    {"cli"},
]  # fmt: skip
LAYER_OF = {unit: number for number, layer in enumerate(LAYERS) for unit in layer}

LEARNING = {
    "rpl_data.files", "rpl_data.formats.coco", "rpl_data.geometry", "rpl_data.pose", "rpl_data.torch",
    "rpl_data.types",
}  # fmt: skip
"""What rpl_data.torch and training may know: a trained pipeline does not depend on the labelling tool."""

SLOW = {
    "dask", "distributed", "fastapi", "faster_coco_eval", "matplotlib", "open3d", "plotly", "pycocotools",
    "pyrealsense2", "small_gicp", "torch", "torchvision", "uvicorn",
}  # fmt: skip
"""Imported inside the functions that need them, so that `rpl --help` is quick."""

FILES = sorted([*ROOT.glob("rpl_data/**/*.py"), *ROOT.glob("training/**/*.py")])
IDS = [str(path.relative_to(ROOT)) for path in FILES]


def imported(nodes: Iterator[ast.AST] | list[ast.stmt]) -> Iterator[str]:
    """Full names of what is imported; of `from a import b`, a.b."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative imports hide the layer"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def module_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


@pytest.mark.parametrize("path", FILES, ids=IDS)
def test_imports_go_downwards(path: Path) -> None:
    names = module_of(path).split(".")
    if names[0] == "training" or len(names) == 1:
        return
    assert names[1] in LAYER_OF, f"give {names[1]} a layer in this file"
    for name in imported(ast.walk(ast.parse(path.read_text()))):
        parts = name.split(".")
        if parts[0] != "rpl_data" or len(parts) == 1 or parts[1] == names[1]:
            continue
        lower = LAYER_OF.get(parts[1], 99) < LAYER_OF[names[1]]
        assert lower, f"{module_of(path)} imports {name}, which is not below it"


@pytest.mark.parametrize("path", FILES, ids=IDS)
def test_learning_does_not_know_the_labelling_tool(path: Path) -> None:
    module = module_of(path)
    learning = module.startswith(("rpl_data.torch", "training"))
    # The experiments run everything, from the recording to the table.
    allowed = {"rpl_data"} if module.startswith("training.reproduce") else LEARNING
    for name in imported(ast.walk(ast.parse(path.read_text()))):
        if learning and name.startswith("rpl_data"):
            assert any(f"{name}.".startswith(f"{known}.") for known in allowed), f"{module} imports {name}"
        if name.split(".")[0] in {"torch", "torchvision"}:
            assert learning, f"{module} imports {name}; torch belongs to rpl_data.torch and training"


@pytest.mark.parametrize("path", FILES, ids=IDS)
def test_slow_packages_are_imported_where_used(path: Path) -> None:
    module = module_of(path)
    if module.startswith(("rpl_data.torch", "training", "rpl_data.annotate.")):
        return
    for name in imported(ast.parse(path.read_text()).body):
        assert name.split(".")[0] not in SLOW, f"{module} imports {name} at its top"
