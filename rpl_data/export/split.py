"""Choose which frames train, validate and test: `test` is whole scenes, `val` random frames of the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from rpl_data.files import read_json
from rpl_data.types import DataError

SplitName = Literal["train", "val", "test"]
FrameKey = tuple[str, int]
"""Name of the scene and index of the frame."""


@dataclass(frozen=True)
class SplitRule:
    """Rule for dividing frames into splits.

    Attributes:
        test_scenes: least number of scenes that training never sees (more if that covers every object), or
            their names.
        val_fraction: share of the frames of the other scenes; they are close in time to training frames.
        seed: the same seed and frames give the same split.
    """

    test_scenes: int | tuple[str, ...] = 1
    val_fraction: float = 0.1
    seed: int = 0


def choose_splits(
    frames: Mapping[FrameKey, frozenset[str]], rule: SplitRule
) -> tuple[dict[FrameKey, SplitName], tuple[str, ...]]:
    """Choose the split of every frame; also returns lines for the user.

    Args:
        frames: the objects visible in each frame.
        rule: the requested split.

    Raises:
        DataError: a test scene that does not exist, a fraction outside 0 to 1, or a negative seed.
    """
    if not 0 <= rule.val_fraction < 1:
        raise DataError(f"split: val_fraction must be at least 0 and less than 1, got {rule.val_fraction}")
    if rule.seed < 0:
        raise DataError(f"split: seed must be 0 or more, got {rule.seed}")
    objects_of: dict[str, set[str]] = {}
    for (scene, _), objects in frames.items():
        objects_of.setdefault(scene, set()).update(objects)
    rng = np.random.default_rng(rule.seed)
    test, messages = choose_test_scenes(objects_of, rule.test_scenes, rng)
    splits: dict[FrameKey, SplitName] = {key: "test" if key[0] in test else "train" for key in frames}
    rest = sorted(key for key in frames if key[0] not in test)
    wanted = min(max(1, round(rule.val_fraction * len(rest))), len(rest) - 1) if rule.val_fraction else 0
    for row in rng.permutation(len(rest))[:wanted]:
        splits[rest[row]] = "val"
    return splits, tuple(messages)


def choose_test_scenes(
    objects_of: Mapping[str, set[str]], wanted: int | tuple[str, ...], rng: np.random.Generator
) -> tuple[set[str], list[str]]:
    """Choose scenes for the test split; also returns lines for the user.

    Scenes are taken in random order (from `rng`), but those with most objects not yet tested come first,
    until there are `wanted` and every object is tested; no object loses its last training scene.
    """
    if isinstance(wanted, tuple):
        return _named(objects_of, wanted)
    if wanted == 0:
        return set(), ["no test split: 0 test scenes were asked for"]
    if len(objects_of) < 3:
        return set(), [
            f"no test split: it takes whole scenes that training never saw and there are only "
            f"{len(objects_of)}; record at least 3 scenes"
        ]
    everything = set().union(*objects_of.values())
    order = [sorted(objects_of)[row] for row in rng.permutation(len(objects_of))]
    test: set[str] = set()
    while len(test) < wanted or _objects(objects_of, test) != everything:
        untested = everything - _objects(objects_of, test)
        candidates = [scene for scene in order if _spares(objects_of, test | {scene}) and scene not in test]
        if len(test) >= wanted:
            candidates = [scene for scene in candidates if objects_of[scene] & untested]
        if not candidates:
            break
        test.add(max(candidates, key=lambda scene: len(objects_of[scene] & untested)))
    return test, _complaints(objects_of, test, wanted)


def _named(objects_of: Mapping[str, set[str]], names: Sequence[str]) -> tuple[set[str], list[str]]:
    unknown = sorted(set(names) - set(objects_of))
    if unknown:
        raise DataError(
            f"split: test scene {', '.join(unknown)} has no labels; labelled: {', '.join(sorted(objects_of))}"
        )
    if len(set(names)) == len(objects_of):
        raise DataError("split: every scene is a test scene and none is left to train on; name fewer")
    return set(names), _complaints(objects_of, set(names), len(names))


def _complaints(objects_of: Mapping[str, set[str]], test: set[str], wanted: int) -> list[str]:
    untested = sorted(_objects(objects_of, set(objects_of)) - _objects(objects_of, test))
    messages = []
    if untested:
        messages.append(f"no test scene for {', '.join(untested)}: too few scenes show it to spare one")
    if len(test) < wanted:
        messages.append(f"only {len(test)} of the {wanted} requested test scenes could be spared")
    return messages


def _objects(objects_of: Mapping[str, set[str]], scenes: set[str]) -> set[str]:
    return set().union(*(objects_of[scene] for scene in scenes))


def _spares(objects_of: Mapping[str, set[str]], test: set[str]) -> bool:
    """Whether every object keeps a training scene, and there is one at all."""
    left = set(objects_of) - test
    return bool(left) and _objects(objects_of, left) == _objects(objects_of, set(objects_of))


def assigned_splits(folder: Path) -> dict[FrameKey, tuple[SplitName, int]]:
    """Read the split and image id of every frame of an exported folder."""
    names: tuple[SplitName, ...] = ("train", "val", "test")
    found = {
        (image["scene"], image["frame"]): (name, image["id"])
        for name in names
        if (folder / f"{name}.json").exists()
        for image in read_json(folder / f"{name}.json")["images"]
    }
    if not found:
        raise DataError(f"{folder} holds no exported COCO files; export the labels first")
    return found
