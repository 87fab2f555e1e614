"""Draw damaged and hostile variants of good texts, tables and settings."""

import json

from hypothesis import strategies as st

TEXTS = (
    "",
    "nan",
    "-inf",
    "1e309",
    "-1",
    "0",
    "true",
    "null",
    "../../outside",
    "/etc/passwd",
    "~/.profile",
    "a\0b",
    "\x1b[2J",
    "=1+1",
    "$\\bad{0$",
    "${oc.env:HOME}",
    "${seed}",
    "{a: &a [*a]}",
    '"',
    "\n",
    ",",
    ";",
    "\ufeff",
    "ü" * 300,
    "9" * 5000,
    "[" * 3000,
)
VALUES = (
    None,
    True,
    -1,
    0,
    1,
    0.5,
    2**63,
    10**400,
    1e308,
    float("nan"),
    float("inf"),
    [],
    {},
    [1, 2],
    {"_target_": "os.mkdir", "path": "outside"},
    {"value": 1, "low": 2, "high": 0},
    *TEXTS[:-2],
)
SHAPES = ("replace", "remove", "rename", "copy")


@st.composite
def damaged_bytes(draw, content):
    """Return bytes with changed, removed, repeated or replaced parts."""
    for _ in range(draw(st.integers(1, 4))):
        first = draw(st.integers(0, max(len(content) - 1, 0)))
        last = first + draw(st.sampled_from([0, 1, 2, 8, 64, 4096]))
        part = draw(
            st.one_of(
                st.binary(max_size=8),
                st.sampled_from([text.encode() for text in TEXTS]),
                st.just(content[first:last] * 2),
                st.just(b"\xff" * (last - first)),
            )
        )
        content = content[:first] + part + content[last:]
    if draw(st.integers(0, 9)) == 0:
        content = content[: len(content) // 2]
    return content


@st.composite
def damaged_csv(draw, text):
    """Return a table's text with other cells, rows, columns, separators or codes."""
    rows = [line.split(",") for line in text.splitlines()]
    for _ in range(draw(st.integers(1, 4))):
        row = draw(st.integers(0, len(rows) - 1))
        column = draw(st.integers(0, max(len(rows[row]) - 1, 0)))
        match draw(st.integers(0, 7)):
            case 0 | 1:
                rows[row][column : column + 1] = [draw(st.sampled_from(TEXTS))]
            case 2:
                value = draw(st.sampled_from(TEXTS))
                rows = rows[:1] + [
                    [*cells[:column], value, *cells[column + 1 :]] for cells in rows[1:]
                ]
            case 3:
                rows = [cells[:column] + cells[column + 1 :] for cells in rows]
            case 4:
                rows = [[*cells, *cells[column : column + 1]] for cells in rows]
            case 5:
                rows = rows[:row] or rows
            case 6:
                rows = rows + rows[row:]
            case 7:
                rows = rows[:1] + rows[:0:-1]
    separator = draw(st.sampled_from([",", ",", ",", ";", "\t", " "]))
    end = draw(st.sampled_from(["\n", "\r\n", "\r"]))
    code = draw(st.sampled_from(["utf-8", "utf-8", "utf-8-sig", "utf-16", "latin-1"]))
    lines = [separator.join(cells) for cells in rows]
    return end.join(lines).encode(code, "replace")


def paths_in(document, path=()):
    """Yield the path of every value in nested lists and mappings."""
    pairs = ()
    if isinstance(document, dict):
        pairs = document.items()
    elif isinstance(document, list):
        pairs = enumerate(document)
    for key, value in pairs:
        yield (*path, key)
        yield from paths_in(value, (*path, key))


@st.composite
def damaged_document(draw, document):
    """Return nested settings with other values, names or shapes."""
    document = json.loads(json.dumps(document))
    for _ in range(draw(st.integers(1, 3))):
        paths = list(paths_in(document))
        if not paths:
            return document
        *parents, key = draw(st.sampled_from(paths))
        holder = document
        for name in parents:
            holder = holder[name]
        shape = draw(st.sampled_from(SHAPES))
        value = draw(st.sampled_from(VALUES))
        if shape == "remove":
            del holder[key]
        elif shape == "rename" and isinstance(holder, dict):
            holder[draw(st.sampled_from(TEXTS[:-2]))] = holder.pop(key)
        elif shape == "copy" and isinstance(holder, dict):
            other = draw(st.sampled_from(paths))
            holder[str(other[-1])] = holder[key]
        else:
            holder[key] = value
    return document
