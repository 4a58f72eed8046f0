"""YAML of others: no text makes reading it endless, or ends the process."""

from __future__ import annotations

import pytest

from rpl_data.types import DataError
from rpl_data.untrusted.yaml_text import DEEPEST, read_yaml


def repeating(*, levels: int, times: int) -> str:
    """Lists of which each names the one before so many times."""
    lines = ["a0: &a0 [x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * times)}]" for n in range(1, levels)]
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (repeating(levels=12, times=10), "aliases repeat too much"),
        ("[" * 200_000 + "]" * 200_000, "too deeply nested"),  # libyaml alone ends by SIGSEGV
        ("a: &a [1, *a]", "contains itself"),
        ("a: 1\nb: 2\na: 3", "key 'a' is there twice"),
        ("a: *b", "undefined alias"),
        ("when: 2001-99-99", "month must be in"),
        ("a: !!python/object/apply:os.system [true]", "could not determine a constructor"),
        ("a: [", "not valid YAML"),
    ],
)
def test_is_refused_in_one_line(text: str, why: str) -> None:
    with pytest.raises(DataError, match=why) as refusal:
        read_yaml(text, source="x.yaml")
    assert str(refusal.value).startswith("x.yaml is not valid YAML: ") and "\n" not in str(refusal.value)


def test_aliases_are_read_where_they_repeat_little() -> None:
    assert read_yaml(repeating(levels=3, times=3), source="x")["a2"] == [[["x"]] * 3] * 3
    assert read_yaml("[" * (DEEPEST - 2) + "]" * (DEEPEST - 2), source="x")
    assert read_yaml("base: &base {rate: 1}\nlabel: {<<: *base, rate: 2}", source="x")["label"] == {"rate": 2}
