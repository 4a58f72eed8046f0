"""`method: paper` in a recipe: what it sets, and that every stage obeys."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from rpl_data.pipeline.presets import METHODS, by_method
from rpl_data.pipeline.recipe import Recipe
from rpl_data.pipeline.recipe_file import load_recipe, parse_recipe, recipe_to_yaml
from rpl_data.types import DataError

TWIN = {"name": "x", "twin": {}}


def test_paper_chooses_the_papers_way_in_every_stage() -> None:
    recipe = parse_recipe({**TWIN, "method": "paper"}, source="recipe")
    assert recipe.reconstruct.method == "given"
    assert recipe.solve.method == "slsqp"
    assert not recipe.refine.scenes
    assert not recipe.refine.frames
    assert recipe.segment.method == "smooth"
    assert recipe.label.method == "splat"
    assert recipe.export.min_quality == 0
    assert recipe == by_method(parse_recipe(TWIN, source="recipe"), "paper")
    assert parse_recipe({**TWIN, "method": "ours"}, source="recipe") == parse_recipe(TWIN, source="recipe")


def test_what_the_recipe_says_itself_stays() -> None:
    own = {"reconstruct": {"method": "track"}, "label": {"rate": 5.0}, "export": ["yolo"]}
    recipe = parse_recipe({**TWIN, **own, "method": "paper"}, source="recipe")
    assert recipe.reconstruct.method == "track"
    assert (recipe.label.rate, recipe.label.method) == (5.0, "splat")
    assert (recipe.export.formats, recipe.export.min_quality) == (("yolo",), 0)


def test_the_resolved_recipe_spells_out_every_choice(tmp_path: Path) -> None:
    recipe = parse_recipe({**TWIN, "method": "paper"}, source="recipe")
    text = recipe_to_yaml(recipe)
    assert "\nmethod:" not in text
    (tmp_path / "recipe.yaml").write_text(text)
    assert load_recipe(tmp_path / "recipe.yaml") == recipe


def test_every_name_in_a_method_is_an_option() -> None:
    for method in METHODS:
        assert isinstance(by_method(Recipe("x"), method), Recipe)
    robust = replace(by_method(Recipe("x"), "paper").solve, method="robust")
    assert robust == Recipe("x").solve


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"method": "papers"}, "method must be `ours` or `paper`, not 'papers'"),
        ({"method": None}, "method must be `ours` or `paper`, not None"),
        ({"method": ["paper"]}, "method must be"),
        ({"metod": "paper"}, "did you mean 'method'"),
        ({"method": "paper", "solve": 3}, "solve must hold `key: value` lines, not 3"),
        ({"method": "paper", "segment": {"method": "grow"}}, "segment.method"),
    ],
)
def test_refused(data: dict[str, object], message: str) -> None:
    with pytest.raises(DataError, match=message):
        parse_recipe({**TWIN, **data}, source="recipe")
