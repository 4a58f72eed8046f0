"""Damage: what a bad disk, an interrupted copy, a hasty hand or an enemy does to a file."""

from __future__ import annotations

import json
import random
import re
from collections.abc import Callable, Iterator
from typing import Any

STRANGE: tuple[Any, ...] = (
    None, True, -1, 0, 1e308, 10**30, "", "../../../x", "nan", [], {}, [[1]], {"a": 1}, "\ud800",
    float("nan"), float("inf"), "x" * 5000,
)  # fmt: skip
WORDS = (b"nan", b"inf", b"-1", b"", b"1e999", b"../../x", b"1,5", b"\xff\xfe", b"9" * 5000, b"None", b"[[[[")


def bytes_of(content: bytes, chance: random.Random) -> bytes:
    """The content with some bytes changed, lost, doubled, or cut off."""
    spoilt = bytearray(content)
    for _ in range(chance.choice([1, 1, 2, 8])):
        if not spoilt:
            break
        span = len(spoilt) if chance.random() < 0.5 else min(len(spoilt), 300)
        at, kind = chance.randrange(span), chance.randrange(7)
        if kind == 0:
            spoilt[at] = chance.randrange(256)
        elif kind == 1:
            spoilt[at] ^= 1 << chance.randrange(8)
        elif kind == 2:
            del spoilt[at : at + chance.randrange(1, 20)]
        elif kind == 3:
            spoilt[at:at] = chance.randbytes(chance.randrange(1, 9))
        elif kind == 4:
            del spoilt[at:]
        elif kind == 5:
            spoilt[at : at + 4] = chance.choice(
                [b"\xff" * 4, bytes(4), b"\xff\xff\xff\x7f", b"9999", b" nan"]
            )
        else:
            spoilt[at:at] = spoilt[at : at + chance.randrange(1, 50)]
    return bytes(spoilt)


def words_of(content: bytes, chance: random.Random) -> bytes:
    """A text with one word, or one line, replaced, doubled, swapped or lost."""
    lines = content.split(b"\n")
    at = chance.randrange(len(lines))
    words = re.split(rb"([\s,]+)", lines[at])
    match chance.randrange(5):
        case 0:
            words[chance.randrange(len(words))] = chance.choice(WORDS)
            lines[at] = b"".join(words)
        case 1:
            lines.insert(at, lines[at])
        case 2:
            del lines[at]
        case 3:
            other = chance.randrange(len(lines))
            lines[at], lines[other] = lines[other], lines[at]
        case _:
            lines[at] = lines[at][: chance.randrange(len(lines[at]) + 1)]
    return b"\n".join(lines)


def fields_of(content: bytes, chance: random.Random) -> bytes:
    """JSON, or lines of JSON, with one value anywhere in it replaced, one field lost, or one added."""
    try:
        lines = [json.loads(line) for line in content.splitlines()]
        several = True
    except ValueError:
        lines, several = [json.loads(content)], False
    places = list(_places(lines))
    where, key = chance.choice(places)
    match chance.randrange(4):
        case 0:
            del where[key]
        case 1 if isinstance(where, dict):
            where["more"] = 1
        case _:
            where[key] = chance.choice(STRANGE)
    texts = [json.dumps(line) for line in lines]
    return "\n".join(texts if several else texts[:1]).encode() + b"\n" if texts else b""


def _places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Every container in a value with every key in it, not all items of long lists."""
    keys = (
        value.keys()
        if isinstance(value, dict)
        else range(min(len(value), 6))
        if isinstance(value, list)
        else ()
    )
    for key in keys:
        yield value, key
        yield from _places(value[key])


Damage = Callable[[bytes, random.Random], bytes]


def kinds_for(name: str) -> tuple[Damage, ...]:
    """The kinds of damage for a file, by its suffix."""
    if name.endswith((".json", ".jsonl")):
        return fields_of, bytes_of, fields_of
    if name.endswith((".txt", ".poses", ".csv", ".yaml")):
        return words_of, bytes_of, words_of
    return (bytes_of,)
