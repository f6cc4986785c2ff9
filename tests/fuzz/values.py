"""Unusual values, damaged bytes and changed documents."""

from copy import deepcopy

from hypothesis import strategies as st

WORDS = (
    "", " ", "\n", "nan", "-1", "1e308", "9" * 400, "../x", "[bold]b[/bold]", "[/nope]", "x" * 20_000, '"', "ego",
    "png", "16UC1", "\x1b[31mred", "\x9b2J", "/a\nb", "\u202etxt", "%s{0}", "\U0001f600", "zstd", "/tf",
)  # fmt: skip
LIMITS = (0, 1, 255, 65535, 2**31 - 1, 2**32 - 1, 10**10, 2**53, 2**63 - 1, 2**64 - 1)
NUMBERS = (0.0, -1.0, 1e-9, 5e-324, 1e9, 1e30, 3e38, 1e300, 1e308, float("nan"), float("inf"), -float("inf"))
texts = st.sampled_from(WORDS) | st.text(max_size=20)
floats = st.sampled_from(NUMBERS) | st.floats()
documents = st.recursive(
    st.none() | st.booleans() | texts | floats | st.sampled_from([*LIMITS, -1, 10**400]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts, inner, max_size=3),
    max_leaves=5,
)


def integers(bits, *, signed=False):
    """Integers of this width, often at its limits."""
    low, high = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if signed else (0, 2**bits - 1)
    near = [value for limit in LIMITS for value in (limit, -limit) if low <= value <= high]
    return st.sampled_from(near) | st.integers(low, high)


@st.composite
def damaged(draw, data):
    """The bytes with one to three changed stretches, or cut."""
    data = bytearray(data)
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, max(len(data) - 1, 0)))
        new = draw(st.binary(min_size=1, max_size=8) | integers(64).map(lambda value: value.to_bytes(8, "little")))
        how = draw(st.sampled_from(("replace", "replace", "insert", "remove", "repeat", "cut")))
        if how == "repeat":
            new = data[at : at + 500]
        end = {"replace": at + len(new), "remove": at + 64, "cut": len(data)}.get(how, at)
        data[at:end] = b"" if how in ("remove", "cut") else new
    return bytes(data)


@st.composite
def changed(draw, tree):
    """A document with one to three values replaced, removed or repeated."""
    root = {"root": deepcopy(tree)}
    for _ in range(draw(st.integers(1, 3))):
        places = list(_places(root["root"])) or [(root, "root")]
        container, key = places[draw(st.integers(0, len(places) - 1))]
        how = draw(st.sampled_from(("value", "value", "value", "remove", "repeat")))
        if how == "remove" and container is not root:
            del container[key]
        else:
            container[key] = [container[key]] * 1000 if how == "repeat" else draw(documents)
    return root["root"]


def _places(tree):
    """(container, key) of every value in a tree of dictionaries and lists."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in items:
        yield tree, key
        yield from _places(value)
