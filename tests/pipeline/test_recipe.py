"""Recipes: what is read, what is written back, and what is refused."""

from pathlib import Path

import pytest

from rpl_data.pipeline.recipe import ExportRecipe, Recipe
from rpl_data.pipeline.recipe_faults import misfit
from rpl_data.pipeline.recipe_file import load_recipe, parse_recipe, recipe_to_yaml
from rpl_data.types import DataError

DATASETS = Path(__file__).parents[2] / "datasets"
CUBE = """
name: cube_on_desk
scenes:
  - {format: rpl, path: desk}
objects:
  - {name: cube, keypoints: 8, clicks: desk/clicks.csv, skeleton: [[0, 1]]}
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "recipe.yaml"
    path.write_text(text)
    return path


def test_paths_start_at_the_recipe_or_at_the_root(tmp_path: Path) -> None:
    path = written(tmp_path, CUBE)
    assert load_recipe(path).scenes[0].path == tmp_path.resolve() / "desk"
    recipe = load_recipe(path, root=Path("/data"))
    assert recipe.scenes[0].path == Path("/data/desk")
    assert recipe.objects[0].clicks == Path("/data/desk/clicks.csv")


def test_defaults_are_the_papers(tmp_path: Path) -> None:
    recipe = load_recipe(written(tmp_path, CUBE))
    assert recipe.label.rate_hz == 3
    assert recipe.split.val_fraction == 0.1
    assert recipe.objects[0].keypoint_names == tuple("01234567")
    assert recipe.objects[0].skeleton == ((0, 1),)


@pytest.mark.parametrize("path", sorted(DATASETS.glob("*.yaml")), ids=lambda path: path.stem)
def test_written_recipe_reads_back_the_same(path: Path, tmp_path: Path) -> None:
    recipe = load_recipe(path, root=tmp_path)
    assert load_recipe(written(tmp_path, recipe_to_yaml(recipe))) == recipe


def test_recording_recipe_names_every_field(tmp_path: Path) -> None:
    import yaml

    given = yaml.safe_load((DATASETS / "recording.yaml").read_text())
    whole = yaml.safe_load(recipe_to_yaml(load_recipe(DATASETS / "recording.yaml")))
    assert given.keys() == whole.keys() - {"twin"}
    for part in ("reconstruct", "solve", "refine", "segment", "label", "split"):
        assert given[part].keys() == whole[part].keys()
    assert given["scenes"][0].keys() == whole["scenes"][0].keys()
    assert given["scenes"][0]["mend"] == whole["scenes"][0]["mend"]
    assert given["objects"][0].keys() == whole["objects"][0].keys()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("scens: []", "unknown key 'scens'; did you mean 'scenes'"),
        ("scenes: [{path: a, fromat: b}]", r"unknown key 'scenes\[0\].fromat'; did you mean 'format'"),
        ("split: {val_fractoin: 3}", "unknown key 'split.val_fractoin'; did you mean 'val_fraction'"),
        ("scenes: [{format: rpl}]", r"scenes\[0\].path is missing"),
        ("scenes: rec", r"scenes must be a list, as \[a, b\], not 'rec'"),
        ("scenes: [{path: a, names: [00]}]", r"scenes\[0\].names\[0\] must be text, in quotes .*, not 0"),
        ("scenes: [{path: a, camera: [500, 500, x, 240]}]", r"camera\[2\] must be a number, not 'x'"),
        ("scenes: [{path: a, mend: {pose_lag: 1.5}}]", "mend.pose_lag must be a whole number, not 1.5"),
        ("objects: [{name: cup}]", r"objects\[0\].keypoints is missing"),
        ("objects: [{name: c, keypoints: 3, skeleton: [[0]]}]", r"skeleton\[0\] must be a list of 2"),
        ("reconstruct: track", "reconstruct must hold `key: value` lines, not 'track'"),
        ("reconstruct: {method: trak}", "method must be `auto`, `given` or `track`, not 'trak'"),
        ("refine: {scenes: perhaps}", "refine.scenes must be true or false, not 'perhaps'"),
        ("refine: {frames: perhaps}", "refine.frames must be true or false or `auto`, not 'perhaps'"),
        ("twin: {scenes: four}", "twin.scenes must be a whole number or a list"),
        ("scenes: []", "no scenes"),
        ("scenes: [{path: a}]", "no objects"),
        ("label: {rate: often}\ntwin: {}", "label.rate must be a number or `all`, not 'often'"),
        ("label: {rate: 0}\ntwin: {}", "label.rate must be positive"),
        ("scenes: [{path: a}]\nobjects: [{name: c, keypoints: 2}]", "at least 3 keypoints, got 2"),
        ("scenes: [{path: a}]\nobjects: [{name: c, keypoints: 3, skeleton: [[0, 3]]}]", "beyond 0..2"),
        ("twin: {}\nsplit: {val_fraction: 1.5}", "val_fraction must be in"),
        ("twin: {}\nsplit: {seed: -1}", "split.seed must be 0 or more, got -1"),
        ("[", "not valid YAML"),
        ("twin: {}\nlabel: {rate: 3}\nlabel: {rate: 1}", "key 'label' is there twice"),
        ("twin: {scenes: 3, scenes: 4}", "key 'scenes' is there twice"),
        ("twin: !!python/object:os.system {}", "not valid YAML"),
        ("truth: 2024-13-45", "not valid YAML"),
        ("twin: {}\nlabel: {rate: .inf}", "label.rate must be a finite number"),
        ("twin: {}\nlabel: {rate: null}", "label.rate has no value"),
        ("twin: {}\nexport: null", "export has no value"),
        ("twin: {}\nexport: {format: [coco]}", "unknown key 'export.format'; did you mean 'formats'"),
        ("twin: {}\nexport: {min_quality: 1}", r"export.min_quality must be in \[0, 1\)"),
        ("twin: {}\nreconstruct: {voxel_m: 0}", "voxel_m must be 0.0002 to 0.1"),
        ("scenes: [{path: a}]\nobjects: [{name: c, keypoints: 1000000000}]", "at most 200 keypoints"),
        ("scenes: [{path: a}]\nobjects: [{name: c, keypoints: [a, b, a]}]", "two keypoints are called 'a'"),
        ("scenes: [{path: a, names: [../b]}]\nobjects: [{name: c, keypoints: 3}]", "name of a scene"),
        (
            "scenes: [{path: a}]\n"
            "objects: [{name: c, keypoints: 3, crop: {low_m: [0, 0, 0], high_m: [1, 1, .inf]}}]",
            "finite number",
        ),
    ],
)
def test_refused(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(DataError, match=message) as error:
        load_recipe(written(tmp_path, f"name: x\n{text}\n"))
    assert "\n" not in str(error.value)
    assert str(tmp_path) in str(error.value)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", ExportRecipe(("coco",), 0.25)),
        ("export: [coco, yolo]", ExportRecipe(("coco", "yolo"), 0.25)),
        ("export: {formats: [coco, bop], min_quality: 0.5}", ExportRecipe(("coco", "bop"), 0.5)),
    ],
)
def test_exports_are_a_list_of_formats_or_say_more(text: str, expected: ExportRecipe, tmp_path: Path) -> None:
    recipe = load_recipe(written(tmp_path, f"name: x\ntwin: {{}}\n{text}\n"))
    assert recipe.export == expected
    assert load_recipe(written(tmp_path, recipe_to_yaml(recipe))).export == expected


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="nowhere.yaml does not exist; give the recipe, a YAML file"):
        load_recipe(tmp_path / "nowhere.yaml")
    with pytest.raises(DataError, match="is a folder; give the recipe"):
        load_recipe(tmp_path)


def test_what_the_parser_takes_is_no_misfit() -> None:
    """Numbers that YAML reads as text are numbers, and a union takes either of its kinds."""
    data = {
        "name": "x",
        "scenes": [{"path": "a", "metres_per_unit": "1e-3", "names": None}],
        "objects": [{"name": "c", "keypoints": ["a", "b", "c"], "skeleton": [[0, 1]]}],
        "label": {"rate": "all"},
        "split": {"test_scenes": ["00"]},
    }
    parse_recipe(data, source="x.yaml")
    assert misfit(Recipe, data, "") is None
