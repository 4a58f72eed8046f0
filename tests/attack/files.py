"""Each file of a small recording and its workspace is damaged in turn, and the dataset built again.

A build may end with the same dataset, or say in a line what it did about the damage: refused it, left a frame
out, or made the file again. Anything else is a fault.
"""

from __future__ import annotations

import random
import re
import shutil
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path

from attack.children import End, command, ended, files_in
from attack.damage import Damage, kinds_for

RECIPE = """
name: small
scenes: [{path: recording, metres_per_unit: 0.001}]
objects: [{name: carton, keypoints: [KEYPOINTS], clicks: recording/clicks.csv}]
label: {rate: all}
"""
UNTIL = {"recording": ("import", "solve"), "ws": ("status", "export", "report")}
"""The commands that follow damage to a folder: those that read what was damaged, and little else."""
PRODUCTS = ("scene.json", "trajectory.txt", "solution.json", "train.json", "val.json", "test.json")
LEFT_ALONE = ("recipe.yaml", "build.lock", "html")
"""Not judged by their bytes: a recipe may be written in another way, a report holds times."""


def prepare(folder: Path, tiny: Path) -> Path:
    """A recording, a recipe and a workspace built from them; what cases are copied from."""
    from rpl_data.workspace.workspace import Workspace

    shutil.copytree(tiny / "recording", folder / "recording")
    keypoints = Workspace(folder / "recording/truth").load_solution("carton").model.keypoints
    shutil.rmtree(folder / "recording/truth")
    (folder / "recipe.yaml").write_text(RECIPE.replace("KEYPOINTS", ", ".join(keypoints)))
    assert (
        command("build", str(folder / "recipe.yaml"), "--workspace", str(folder / "ws"), "--workers", "1")
        == 0
    )
    return folder


def case(base: Path, scratch: Path, target: Path, damage: Damage, seed: int) -> End:
    """Damage a file of a copy of `base`, and see what the commands make of it."""
    folder = scratch / "case"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(base, folder, symlinks=True)
    spoilt = folder / target.relative_to(base)
    before = spoilt.read_bytes()
    spoilt.unlink()
    spoilt.write_bytes(damage(before, random.Random(seed)))
    return ended(partial(_judge, base, folder, target.relative_to(base).parts[0]))


def _judge(base: Path, folder: Path, what: str) -> str:
    """`said`, `same` or `difference`."""
    ws = str(folder / "ws")
    for name in UNTIL[what]:
        if name == "import":
            status = command("import", str(folder / "recipe.yaml"), "--workspace", ws)
        elif name == "status":
            status = command("status", "--workspace", ws)
        else:
            status = command(name, "--workspace", ws, *(["--again", "true"] if name == "export" else []))
        if status:
            return "said"  # `attack` looks whether the last net said it
    return "same" if _products(base, base) == _products(folder, base) else "difference"


def _products(folder: Path, base: Path) -> dict[str, str]:
    """The products of a workspace as text, without the folder that it or its recording lies in."""
    found = [path for path in files_in(folder / "ws") if path.name in PRODUCTS]
    texts = {str(path.relative_to(folder)): path.read_text(errors="replace") for path in found}
    return {
        name: _rounded(text.replace(str(folder), "BASE").replace(str(base), "BASE"))
        for name, text in texts.items()
    }


def _rounded(text: str) -> str:
    """A text with all long numbers to six digits: the order of clicks changes the last ones of a solve."""
    return re.sub(r"-?\d+\.\d{6,}(e-?\d+)?", lambda found: f"{float(found[0]):.6g}", text)


def attack(base: Path, scratch: Path, rounds: int, tell: Callable[[str], None]) -> Counter[str]:
    """Damage every file `rounds` times; the number of ends by folder, kind of damage and kind of end."""
    counts: Counter[str] = Counter()
    for what in UNTIL:  # a case without damage, or the others would prove nothing
        control = case(base, scratch, files_in(base / what)[0], lambda content, chance: content, seed=0)
        assert control.kind == "same", control
    targets = [path for name in UNTIL for path in files_in(base / name) if not path.name.endswith(LEFT_ALONE)]
    for number in range(rounds):
        for target in targets:
            kinds = kinds_for(target.name)
            damage = kinds[number % len(kinds)]
            end = case(base, scratch, target, damage, seed=1000 * number + len(target.name))
            kind = "traceback" if "unexpected fault" in end.text else end.kind
            if kind == "difference" and "WARNING" not in end.text and _is_said(end.text):
                kind = "said"
            counts[f"{target.relative_to(base).parts[0]} {damage.__name__}: {kind}"] += 1
            if kind not in ("same", "said"):
                tell(f"{kind}: {target.relative_to(base)} {damage.__name__} {number}: {end.text[-1500:]}")
    return counts


def _is_said(text: str) -> bool:
    """Whether a line about the damage was printed: scenes and objects are said with a colon."""
    return any(line.startswith("    ") for line in text.splitlines())
