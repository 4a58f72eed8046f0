"""Mistakes on a command line: one line each, with what was probably meant."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Literal

import pytest
from jsonargparse import ArgumentParser

from rpl_data.cli.main import COMMANDS, main
from rpl_data.command_line import as_spelt, one_line, parser_of
from rpl_data.pipeline.recipe_file import load_recipe


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["biuld"], "rpl: there is no command 'biuld'; did you mean build? See `rpl --help`"),
        (["clicks", "exprt"], "rpl clicks: there is no command 'exprt'; did you mean export? See"),
        (["xyzzy"], "rpl: there is no command 'xyzzy'; there are 'build', 'status'"),
        (["label", "--agian", "true"], "rpl label: there is no option --agian; did you mean --again? See"),
        (["label", "--workers", "two"], "rpl label: --workers: expected int, found 'two'; see"),
        (["build", "a.yaml", "b"], "rpl build: too many arguments: b; see"),
        (["register", "cube"], "rpl register: scene is missing; see `rpl register --help`"),
        (["init", "my.yaml"], "rpl init: --from is missing; see `rpl init --help`"),
        (["dataset", "count", "a"], "rpl dataset: there is no command 'count'; there are 'merge', 'filter'"),
        (["completion", "fish"], "rpl completion: --shell: expected bash or zsh, found 'fish'; see"),
        (["export", "--split", "tst"], "rpl export: --split: expected train or val or test, found"),
        (["init", "a", "--from", "b", "--camera", "6"], "rpl init: --camera: expected a list in brackets"),
        (["propose", "a.ckpt", "b"], "rpl propose: --keypoints: expected a list in brackets, '[one, "),
        (["export", "--split", "all"], "rpl export: --split: expected train or val or test, found 'all'"),
        (["dataset", "merge", "a", "[b]", "--images", "no"], "rpl dataset merge: --images: expected link or"),
        ([], "rpl: a command is missing; see `rpl --help`"),
    ],
)
def test_a_mistyped_command_is_one_line(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        main(arguments)
    told = capsys.readouterr().err
    assert end.value.code == 2 and told.count("\n") == 1
    assert told.startswith(said)


@pytest.mark.parametrize(
    ("given", "names"),
    [("[00, 05]", ("00", "05")), ("[00,'01']", ("00", "01")), ('["007"]', ("007",)), ("00", ("00",))],
)
def test_names_of_scenes_are_no_numbers(given: str, names: tuple[str, ...]) -> None:
    parser = parser_of(COMMANDS, program="rpl", description="")
    for command in (["filter", "a", "b", "--scenes"], ["split", "a", "b", "--test-scenes"]):
        for words in ([*command, given], [*command[:-1], f"{command[-1]}={given}"]):
            values = parser.parse_args(as_spelt(parser, ["dataset", *words])).dataset
            chosen = values.filter.scenes if command[0] == "filter" else values.split.test_scenes
            assert tuple(chosen) == names
    values = parser.parse_args(as_spelt(parser, ["dataset", "split", "a", "b", "--test_scenes", "2"]))
    assert values.dataset.split.test_scenes == 2


def test_an_option_may_be_named_without_its_group() -> None:
    options = ["--learning.epochs", "--learning.batch", "--seed"]
    said = one_line("unrecognized arguments: --epoch 5", options)
    assert said == "there is no option --epoch; did you mean --learning.epochs?"
    assert (
        one_line("unrecognized arguments: --nothing.like=1", options) == "there is no option --nothing.like"
    )


def test_the_recipe_in_the_help_is_one(tmp_path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["build", "--help"])
    shown = capsys.readouterr().out.split("The smallest recipe")[1].split("\n\n")[1]
    (tmp_path / "my.yaml").write_text(shown)
    recipe = load_recipe(tmp_path / "my.yaml")
    assert [len(item.keypoint_names) for item in recipe.objects] == [8]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["solve", "--again"], ["solve", "--again", "true"]),
        (["solve", "--again", "false"], ["solve", "--again", "false"]),
        (["solve", "--again", "--workspace", "ws"], ["solve", "--again", "true", "--workspace", "ws"]),
        (["register", "--auto", "cube", "00"], ["register", "--auto", "true", "cube", "00"]),
        (["export", "--min-quality", "0.5"], ["export", "--min_quality", "0.5"]),
        (["export", "--min-quality=0.5"], ["export", "--min_quality=0.5"]),
        (["build", "my.yaml", "--again", "solve"], ["build", "my.yaml", "--again", "solve"]),
        (["clicks", "import", "a.csv", "--proposed"], ["clicks", "import", "a.csv", "--proposed", "true"]),
    ],
)
def test_switches_need_no_value_and_dashes_will_do(arguments: list[str], expected: list[str]) -> None:
    parser = parser_of(COMMANDS, program="rpl", description="")
    assert as_spelt(parser, arguments) == expected


def test_a_shell_completes_commands_and_options(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "bash"]) == 0
    (tmp_path / "rpl.sh").write_text(capsys.readouterr().out)
    for line, offered in {
        "rpl reg": "register",
        "rpl train keypoints --learning.ep": "--learning.epochs",
        "rpl capture --camera o": "orbbec",
    }.items():
        words = line.split()
        script = (
            f"source {tmp_path}/rpl.sh; COMP_WORDS=({line}); COMP_CWORD={len(words) - 1}; "
            f"_shtab_rpl rpl {words[-1]} {words[-2]}; echo ${{COMPREPLY[@]}}"
        )
        done = subprocess.run(["bash", "-c", script], capture_output=True, text=True)
        assert offered in done.stdout.split(), line


def test_an_option_may_be_true_false_or_a_word() -> None:
    def look(depth: bool | Literal["auto"] = "auto", bop: bool = False) -> None:
        """Look."""

    parser = ArgumentParser(exit_on_error=False)
    parser.add_function_arguments(look)
    for words, found in ((["--depth"], True), (["--depth", "auto"], "auto"), (["--depth", "--bop"], True)):
        assert parser.parse_args(as_spelt(parser, words)).depth == found
