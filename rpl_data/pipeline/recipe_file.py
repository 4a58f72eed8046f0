"""Recipes as YAML: read, checked, and written."""

from __future__ import annotations

import dataclasses
import difflib
import math
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml

from rpl_data.files import FAULTS, read_text
from rpl_data.pipeline.object_store import url_of
from rpl_data.pipeline.presets import fill_in
from rpl_data.pipeline.recipe import Recipe
from rpl_data.pipeline.recipe_faults import misfit
from rpl_data.types import DataError
from rpl_data.untrusted.names import MOST_KEYPOINTS, checked_keypoints, checked_name
from rpl_data.untrusted.yaml_text import read_yaml

AnyRecipe = TypeVar("AnyRecipe")
SMALLEST_VOXEL_M, LARGEST_VOXEL_M = 0.0002, 0.1
"""A depth sensor sees nothing finer than the one; an object is lost in the other."""


def load_recipe(path: str | Path, *, root: str | Path | None = None) -> Recipe:
    """Load the recipe of a YAML file, and make its relative paths absolute.

    Args:
        path: the file.
        root: folder that relative paths start from; the folder of the file when left out.

    Raises:
        DataError: the file is missing, not YAML, has an unknown key, lacks one, or a value has the
            wrong type; the message names the key.
    """
    path = Path(path).expanduser()
    if not path.exists() or path.is_dir():
        found = "is a folder" if path.is_dir() else "does not exist"
        raise DataError(
            f"{path} {found}; give the recipe, a YAML file, which `rpl init` writes; "
            "`rpl build --help` shows the smallest one"
        )
    recipe = recipe_from_text(read_text(path), source=str(path))
    start = path.parent if root is None else Path(root).expanduser()
    return resolve_paths(recipe, start.resolve())


def recipe_from_text(text: str, *, source: str) -> Recipe:
    """Read a recipe from YAML text; paths stay as they are written; DataError as `load_recipe`."""
    return parse_recipe(read_yaml(text, source=source), source=source)


def parse_recipe(data: object, *, source: str) -> Recipe:
    """Make a recipe from parsed YAML; paths stay as they are written."""
    if not isinstance(data, dict):
        raise DataError(
            f"{source}: a recipe is a list of `key: value` lines; `rpl build --help` shows the smallest one"
        )
    if isinstance(data.get("export"), list):
        data = {**data, "export": {"formats": data["export"]}}
    data = fill_in(data, source=source)
    _refuse_unknown_keys(Recipe, data, source, "")
    recipe = _instantiate(data, source)
    _check(recipe, source)
    return recipe


def recipe_to_yaml(recipe: Recipe) -> str:
    """Write the recipe as YAML with all defaults; `load_recipe` reads it back."""
    return str(yaml.safe_dump(_plain(dataclasses.asdict(recipe)), sort_keys=False))


def resolve_paths(recipe: AnyRecipe, root: Path) -> AnyRecipe:
    """Make every relative path of a dataclass, at any depth, absolute from `root`."""
    if isinstance(recipe, Path):
        # An absolute path stays as it is, and so does an address.
        return recipe if url_of(recipe) else root / recipe.expanduser()
    if isinstance(recipe, tuple):
        return tuple(resolve_paths(item, root) for item in recipe)  # type: ignore[return-value]
    if dataclasses.is_dataclass(recipe) and not isinstance(recipe, type):
        fields = {f.name: resolve_paths(getattr(recipe, f.name), root) for f in dataclasses.fields(recipe)}
        return dataclasses.replace(recipe, **fields)
    return recipe


def _plain(value: Any) -> Any:
    """Convert paths and tuples to strings and lists, for YAML."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value


def _refuse_unknown_keys(kind: Any, value: object, source: str, where: str) -> None:
    """Raise a DataError at the first key that the dataclass (or one inside it) does not have."""
    if typing.get_origin(kind) in (typing.Union, types.UnionType, tuple):
        for inner in typing.get_args(kind):
            for number, item in enumerate(value if isinstance(value, list) else [value]):
                _refuse_unknown_keys(
                    inner, item, source, f"{where}[{number}]" if isinstance(value, list) else where
                )
    if not (dataclasses.is_dataclass(kind) and isinstance(value, Mapping)):
        return
    hints = typing.get_type_hints(kind)
    for key, item in value.items():
        name = f"{where}.{key}" if where else str(key)
        if key not in hints:
            allowed = [*hints, *(["method"] if kind is Recipe else [])]
            near = difflib.get_close_matches(str(key), allowed, n=1, cutoff=0.4)
            hint = f"did you mean {near[0]!r}? " if near else ""
            raise DataError(f"{source}: unknown key {name!r}; {hint}Allowed here: {', '.join(allowed)}")
        if item is None and type(None) not in typing.get_args(hints[key]):
            raise DataError(f"{source}: {name} has no value; give one, or leave the line out for its default")
        _refuse_unknown_keys(hints[key], item, source, name)


def _instantiate(data: dict[str, Any], source: str) -> Recipe:
    """Check the types and build the dataclasses, by jsonargparse."""
    from jsonargparse import ArgumentError, ArgumentParser

    parser = ArgumentParser(exit_on_error=False)
    parser.add_class_arguments(Recipe, "recipe")
    try:
        recipe: Recipe = parser.instantiate(parser.parse_object({"recipe": data})).recipe
    except (ArgumentError, *FAULTS) as error:
        found = misfit(Recipe, data, "")
        said = " ".join(str(error).split()).replace("recipe.", "")  # of what only jsonargparse refuses
        raise DataError(f"{source}: {f'{found.where} {found.text}' if found else said}") from error
    return recipe


def _check(recipe: Recipe, source: str) -> None:
    """Check what types cannot express."""
    if recipe.twin is None and not recipe.scenes:
        raise DataError(f"{source}: no scenes; give at least one {{format, path}} under `scenes:`")
    if recipe.twin is None and not recipe.objects:
        raise DataError(
            f"{source}: no objects; give at least one {{name, keypoints, clicks}} under `objects:`"
        )
    _refuse_infinite(recipe, source, "")
    for scenes in recipe.scenes:
        for name in scenes.names or ():
            checked_name(name, "scene", where=f"{source}: scenes.names")
    _check_objects(recipe, source)
    if recipe.label.rate_hz is not None and recipe.label.rate_hz <= 0:
        raise DataError(f"{source}: label.rate must be positive or `all`, got {recipe.label.rate}")
    if not SMALLEST_VOXEL_M <= recipe.reconstruct.voxel_m <= LARGEST_VOXEL_M:
        raise DataError(
            f"{source}: reconstruct.voxel_m must be {SMALLEST_VOXEL_M} to {LARGEST_VOXEL_M} metres, got "
            f"{recipe.reconstruct.voxel_m}"
        )
    if isinstance(recipe.split.test_scenes, int) and recipe.split.test_scenes < 0:
        raise DataError(f"{source}: split.test_scenes must not be negative, got {recipe.split.test_scenes}")
    if not recipe.reconstruct.max_drift_mm > 0:
        raise DataError(
            f"{source}: reconstruct.max_drift_mm must be positive, got {recipe.reconstruct.max_drift_mm}"
        )
    if not 0 <= recipe.export.min_quality < 1:
        raise DataError(f"{source}: export.min_quality must be in [0, 1), got {recipe.export.min_quality}")
    if not 0 <= recipe.split.val_fraction < 1:
        raise DataError(f"{source}: split.val_fraction must be in [0, 1), got {recipe.split.val_fraction}")
    if recipe.split.seed < 0:
        raise DataError(f"{source}: split.seed must be 0 or more, got {recipe.split.seed}")


def _check_objects(recipe: Recipe, source: str) -> None:
    """Names, keypoints, skeletons and crops of the objects."""
    names = [checked_name(item.name, "object", where=f"{source}: objects.name") for item in recipe.objects]
    if len(set(names)) < len(names):
        raise DataError(f"{source}: two objects have the same name: {', '.join(names)}")
    for item in recipe.objects:
        named = item.keypoints
        count = len(named) if isinstance(named, tuple) else named
        if count > MOST_KEYPOINTS:
            raise DataError(
                f"{source}: object {item.name} has at most {MOST_KEYPOINTS} keypoints, got {count}"
            )
        if count < 3:
            raise DataError(f"{source}: object {item.name} needs at least 3 keypoints, got {count}")
        checked_keypoints(item.keypoint_names, where=f"{source}: keypoints of {item.name}")
        if item.crop is not None and any(
            a >= b for a, b in zip(item.crop.low_m, item.crop.high_m, strict=True)
        ):
            raise DataError(f"{source}: the crop of {item.name} needs every low_m below its high_m")
        if any(not 0 <= end < count for pair in item.skeleton for end in pair):
            raise DataError(f"{source}: the skeleton of {item.name} names keypoints beyond 0..{count - 1}")


def _refuse_infinite(value: Any, source: str, where: str) -> None:
    """DataError at the first number, however deep, that is not finite."""
    if isinstance(value, float) and not math.isfinite(value):
        raise DataError(f"{source}: {where} must be a finite number, got {value}")
    if isinstance(value, tuple):
        for number, item in enumerate(value):
            _refuse_infinite(item, source, f"{where}[{number}]")
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            at = f"{where}.{field.name}" if where else field.name
            _refuse_infinite(getattr(value, field.name), source, at)
