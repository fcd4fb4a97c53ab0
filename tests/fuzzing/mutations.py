"""Ways in which a file can be spoilt, each from a seeded generator: what disks, networks, editors and strangers do."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import yaml  # type: ignore[import-untyped]

Random = np.random.Generator
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_ODD_NUMBERS = (
    *(
        b"nan",
        b"NaN",
        b"inf",
        b"-inf",
        b"Infinity",
        b"1e999",
        b"-1e308",
        b"9" * 400,
        b"9" * 5000,
        b"-1",
        b"0",
        b"1e-320",
    ),
    *(b"9" * 20, b"9" * 400, b"0x10", b"1,5", b"", b"true", b"null", b'"7"', b"[1]", b"{}", b"2147483648"),
)
_GARBAGE = (
    *(
        b"\x00",
        b"\xff\xfe",
        b"\xef\xbb\xbf",
        b"\x1b[2J",
        b"\xe2\x80\xae",
        b"=cmd|' /C calc'!A0",
        b"<script>",
        b"../../../etc/passwd",
    ),
    *(
        b"!!python/object/apply:os.system ['true']",
        b"&a [*a, *a]",
        b"${oc.env:HOME}",
        b"\xf0\x9f\x98\x80",
        b"\xed\xa0\x80",
    ),
    *(b"[" * 3000, b"{" * 300, b"- " * 5000, b"A" * 100_000, b"\r", b"\x85", b"# ", b'"', b"'", b"%n%s", b"/dev/zero"),
)


def flip_bits(content: bytes, random: Random) -> bytes:
    spoilt = bytearray(content)
    for place in random.integers(0, len(content), random.integers(1, 9)):
        spoilt[place] ^= 1 << int(random.integers(8))
    return bytes(spoilt)


def cut(content: bytes, random: Random) -> bytes:
    return content[: random.integers(0, len(content))]


def cut_out(content: bytes, random: Random) -> bytes:
    first, last = sorted(random.integers(0, len(content) + 1, 2).tolist())
    return content[:first] + content[last:]


def repeat(content: bytes, random: Random) -> bytes:
    first, last = sorted(random.integers(0, len(content) + 1, 2).tolist())
    return content[:last] + content[first:last] * int(random.integers(1, 4)) + content[last:]


def overwrite(content: bytes, random: Random) -> bytes:
    place = int(random.integers(0, len(content)))
    what = random.bytes(int(random.integers(1, 64))) if random.random() < 0.5 else bytes(int(random.integers(1, 64)))
    return content[:place] + what + content[place + len(what) :]


def large_size(content: bytes, random: Random) -> bytes:
    """A field of 2, 4 or 8 bytes says very much, or less than nothing."""
    width = int(random.choice([2, 4, 8]))
    place = int(random.integers(0, max(1, min(len(content) - width, 200 if random.random() < 0.7 else len(content)))))
    value = (2 ** (8 * width) - 1, 2 ** (8 * width - 1), 2 ** (8 * width - 2), 0)[random.integers(4)]
    order = "little" if random.random() < 0.5 else "big"
    return content[:place] + value.to_bytes(width, order) + content[place + width :]  # type: ignore[arg-type]


def garbage(content: bytes, random: Random) -> bytes:
    place = int(random.integers(0, len(content) + 1))
    return content[:place] + _GARBAGE[random.integers(len(_GARBAGE))] + content[place:]


def other_line_endings(content: bytes, random: Random) -> bytes:
    ending = (b"\r\n", b"\r", b"\n\n", b"\x0b", b" ")[random.integers(5)]
    return content.replace(b"\n", ending)


def odd_number(content: bytes, random: Random) -> bytes:
    found = list(_NUMBER.finditer(content))
    if not found:
        return flip_bits(content, random)
    chosen = found[random.integers(len(found))]
    return content[: chosen.start()] + _ODD_NUMBERS[random.integers(len(_ODD_NUMBERS))] + content[chosen.end() :]


def shuffle_lines(content: bytes, random: Random) -> bytes:
    lines = content.splitlines(keepends=True)
    chosen = random.integers(0, len(lines), len(lines)) if lines else []
    return b"".join(lines[place] for place in chosen) or b"\n"


def other_type(content: bytes, random: Random) -> bytes:
    """In JSON and YAML, one value anywhere becomes one of another type."""
    comment, _, rest = content.partition(b"\n") if content.startswith(b"#") else (b"", b"", content)
    try:
        tree = json.loads(content) if not comment else yaml.safe_load(rest)
    except (ValueError, RecursionError, yaml.YAMLError):
        return odd_number(content, random)
    places = list(_places(tree))
    if not places:
        return b"[]"
    inside, key = places[random.integers(len(places))]
    others: list[Any] = [
        None,
        True,
        -1,
        1e308,
        10**300,
        "",
        "text",
        "\ud800",
        "a\nb\x1b[31m",
        [],
        [[]],
        {},
        {"a": {"": [0]}},
    ]
    deep: Any = 0
    for _ in range(200):
        deep = [deep]
    inside[key] = [*others, deep][random.integers(len(others) + 1)]
    text = yaml.safe_dump(tree) if comment else json.dumps(tree)
    return (comment + b"\n" if comment else b"") + text.encode(errors="replace")


def _places(tree: Any) -> Any:
    keys = tree if isinstance(tree, dict) else range(len(tree)) if isinstance(tree, list) else ()
    for key in keys:
        yield tree, key
        yield from _places(tree[key])


def nothing_left(content: bytes, random: Random) -> bytes:
    return (b"", b"\n", b"\x00" * 512, random.bytes(512))[random.integers(4)]


MUTATIONS: tuple[Callable[[bytes, Random], bytes], ...] = (
    *(flip_bits, flip_bits, cut, cut, cut_out, repeat, overwrite, large_size, large_size, garbage, garbage),
    *(other_line_endings, odd_number, odd_number, shuffle_lines, other_type, other_type, nothing_left),
)


def mutate(content: bytes, random: Random) -> tuple[bytes, str]:
    """The content spoilt in one way, sometimes in two or three, and the names of the ways."""
    ways = []
    for _ in range(int(random.choice([1, 1, 1, 2, 3]))):
        way = MUTATIONS[random.integers(len(MUTATIONS))]
        content = way(content, random) if content else nothing_left(content, random)
        ways.append(way.__name__)
    return content, ", ".join(ways)
