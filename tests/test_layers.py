"""The layers of the package: imports go only downwards, and stages never import one another."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LAYERS = [
    {"version", "wording"},
    {"types"},
    {"command_line", "compiled", "files", "geometry", "motions"},
    {"directions", "held_out", "json_arrays", "orientation", "registered", "untrusted"},
    {"images", "meshes", "raycast", "overlay", "drift", "symmetries"},
    {"keypoint_surface"},
    {"formats", "clicks", "pose", "reconstruct", "workspace", "synthesize"},
    {"capture", "solve", "refine", "segment", "label", "symmetry", "export", "torch"},
    {"recordings", "place", "dataset"},
    {"twin", "evaluate", "report", "annotate", "doctor"},
    {"pipeline"},
    {"cli"},
]
"""The rooms of `rpl_data`, from the ground to the command line."""

LAYER_OF = {room: number for number, layer in enumerate(LAYERS) for room in layer}
WITHIN_A_LAYER = {("clicks", "workspace"), ("workspace", "clicks")}

LEARNING = {
    "rpl_data.command_line", "rpl_data.files", "rpl_data.formats.datasets", "rpl_data.geometry",
    "rpl_data.images", "rpl_data.json_arrays", "rpl_data.meshes", "rpl_data.motions", "rpl_data.orientation",
    "rpl_data.pose",
    "rpl_data.symmetries", "rpl_data.synthesize", "rpl_data.torch", "rpl_data.types", "rpl_data.wording",
}  # fmt: skip
"""What rpl_data.torch and training may know: a trained pipeline does not depend on the labelling tool."""

CONFINED = {
    "fastapi": {"annotate", "capture"},
    "imagecodecs": {"formats"},
    "uvicorn": {"capture", "cli"},
    "apsw": {"formats"},
    "av": {"formats"},
    "pyrealsense2": {"capture"},
    "open3d": {"export", "meshes", "raycast", "reconstruct", "segment", "twin"},
    "orjson": {"formats"},
    "rosbags": {"formats"},
    "distributed": {"pipeline"},
    "fsspec": {"pipeline"},
    "pycocotools": {"annotate", "evaluate", "export", "formats", "label", "overlay", "torch", "twin"},
}
"""The rooms that need a package; no other imports it."""

SLOW = {
    "av", "cloudpickle", "distributed", "fastapi", "faster_coco_eval", "fsspec", "imagecodecs", "matplotlib",
    "open3d", "plotly", "pycocotools", "pyrealsense2", "small_gicp", "torch", "torchvision", "uvicorn",
}  # fmt: skip
"""Imported inside the functions that need them, so that `rpl --help` is quick."""


PACKAGES = {".".join(path.relative_to(ROOT).parts[:-1]) for path in ROOT.glob("training/**/__init__.py")}


def module_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


@cache
def trees() -> dict[str, ast.Module]:
    """Every module, parsed; by its name."""
    paths = sorted([*ROOT.glob("rpl_data/**/*.py"), *ROOT.glob("training/**/*.py")])
    return {module_of(path): ast.parse(path.read_text()) for path in paths}


@cache
def names_in(module: str) -> tuple[str, ...]:
    """What a module imports, wherever it stands in it."""
    return tuple(imported(module, ast.walk(trees()[module])))


def imported(module: str, nodes: Iterator[ast.AST] | list[ast.stmt]) -> Iterator[str]:
    """Full names of what a module imports; of `from a import b`, a.b."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            start = source(module, node)
            yield from (f"{start}.{alias.name}" for alias in node.names)


def source(module: str, node: ast.ImportFrom) -> str:
    """The full name after `from`. Only the programs of `training`, which have two names, leave it out."""
    inside = module.startswith("training") and (node.level > 0 or node.module.startswith("training"))
    assert (node.level > 0) == inside, (
        f"{module}, line {node.lineno}: relative within training, and only there"
    )
    if not node.level:
        return node.module
    package = module if module in PACKAGES else module.rpartition(".")[0]
    above = package.split(".")[: len(package.split(".")) - node.level + 1]
    return ".".join([*above, node.module] if node.module else above)


def arrows() -> Iterator[tuple[str, str]]:
    """(module, name it imports) for every import within the project, wherever it stands."""
    for module in trees():
        for name in names_in(module):
            if name.split(".")[0] in {"rpl_data", "training"}:
                yield module, name


def room_of(module: str) -> str:
    """The first name below `rpl_data`; empty for the package itself."""
    return (module.split(".") + [""])[1]


def test_every_room_has_a_layer() -> None:
    rooms = {room_of(module) for module in trees() if module.startswith("rpl_data.")}
    assert rooms == LAYER_OF.keys(), "give every room a layer in this file, and no other"


def test_imports_go_downwards() -> None:
    upward = [
        f"{module} imports {name}"
        for module, name in arrows()
        if module.startswith("rpl_data.")
        and room_of(module) != room_of(name)
        and (room_of(module), room_of(name)) not in WITHIN_A_LAYER
        and LAYER_OF.get(room_of(name), 99) >= LAYER_OF[room_of(module)]
    ]
    assert not upward


def test_no_module_imports_itself_by_a_detour() -> None:
    graph: dict[str, set[str]] = {module: set() for module in trees()}
    for module, name in arrows():
        target = name if name in trees() else name.rpartition(".")[0]
        if target in trees() and target != module:
            graph[module].add(target)
    try:
        tuple(TopologicalSorter(graph).static_order())
    except CycleError as error:
        raise AssertionError(f"imports go in a circle: {error.args[1]}") from None


def test_learning_does_not_know_the_labelling_tool() -> None:
    known = []
    for module, name in arrows():
        if not module.startswith(("rpl_data.torch", "training")) or name.startswith("training"):
            continue
        # The experiments run everything, from the recording to the table.
        allowed = {"rpl_data"} if module.startswith("training.reproduce") else LEARNING
        if not any(f"{name}.".startswith(f"{start}.") for start in allowed):
            known.append(f"{module} imports {name}")
    assert not known


def test_torch_stays_where_learning_is() -> None:
    elsewhere = [
        f"{module} imports {name}"
        for module in trees()
        if not module.startswith(("rpl_data.torch", "training"))
        for name in names_in(module)
        if name.split(".")[0] in {"torch", "torchvision"}
    ]
    assert not elsewhere


def test_slow_packages_are_imported_where_used() -> None:
    at_the_top = [
        f"{module} imports {name} at its top"
        for module, tree in trees().items()
        if not module.startswith(("rpl_data.torch", "training", "rpl_data.annotate."))
        for name in imported(module, tree.body)
        if name.split(".")[0] in SLOW
    ]
    assert not at_the_top


@pytest.mark.parametrize("package", CONFINED)
def test_packages_stay_in_the_rooms_that_need_them(package: str) -> None:
    rooms = {
        room_of(module)
        for module in trees()
        if module.startswith("rpl_data")
        for name in names_in(module)
        if name.split(".")[0] == package
    }
    assert rooms == CONFINED[package]


def test_stages_do_not_import_one_another() -> None:
    stages = "rpl_data.pipeline.stages."
    between = {
        f"{module} imports {name}"
        for module, name in arrows()
        if module.startswith(stages) and name.startswith(stages)
    }
    assert not between


def test_the_page_has_no_circle_of_imports() -> None:
    static = ROOT / "rpl_data/annotate/static"
    graph = {
        path.resolve(): {
            (path.parent / name).resolve() for name in re.findall(r'from "(\..*?)"', path.read_text())
        }
        for path in static.rglob("*.js")
    }
    try:
        tuple(TopologicalSorter(graph).static_order())
    except CycleError as error:
        raise AssertionError(f"imports go in a circle: {[p.name for p in error.args[1]]}") from None
