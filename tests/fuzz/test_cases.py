"""The fuzzer's cases are reproducible from name and recipe, and its parsers keep every byte."""

import hashlib
import json

import pytest

from roadperc_stream import log
from tests.fuzz import contents
from tests.fuzz.cases import FAMILIES, WEIGHTED, Case, prepared
from tests.fuzz.judge import Ran, faults
from tests.fuzz.pictures import png, png_chunks, png_of
from tests.fuzz.records import FIXES, put_together, taken_apart

CASES = 40


def made(case, folder):
    """The command, the recipe as text, and a digest of each file."""
    folder.mkdir()
    words, recipe = prepared(case, folder)
    files = {str(path.relative_to(folder)): digest(path) for path in sorted(folder.rglob("*"))}
    return words, json.dumps(recipe), files


def digest(path):
    if path.is_symlink():
        return str(path.readlink())
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "folder"


def test_a_case_follows_from_its_name_and_from_its_recipe(tmp_path):
    families = set()
    for k in range(CASES):
        found = made(Case(f"7:{k}"), tmp_path / f"a{k}")
        assert made(Case(f"7:{k}"), tmp_path / f"b{k}") == found
        recipe = json.loads(found[1])
        assert made(Case("another name", recipe), tmp_path / f"c{k}") == found, recipe
        families.add(recipe["family"])
    assert families == set(WEIGHTED)
    assert set(FAMILIES) == {*families, "files"}


@pytest.mark.parametrize("writer", contents.WRITERS)
@pytest.mark.parametrize("base", contents.BASES)
def test_parsing_and_writing_a_log_keeps_every_byte(tmp_path, base, writer):
    """So the changes of a case are its only faults, whatever is repaired afterwards."""
    content = contents.BASES[base]()
    data = contents.encoded(content, writer)
    for fix in FIXES:
        assert put_together(taken_apart(data), fix) == data
    (tmp_path / "a.mcap").write_bytes(data)
    assert len(list(log.read(log.summarise(tmp_path / "a.mcap")))) == len(content.messages)


def test_parsing_and_writing_a_png_keeps_every_byte():
    data = png(9, 7, mode=3, extra=([b"tEXt", b"a\0b"],))
    assert png_of(png_chunks(data)) == data


def ran(code=0, out=b"", err=b"", crash="", appeared=()):
    return Ran(("replay", "in.mcap"), code, out, err, crash, appeared)


@pytest.mark.parametrize(
    ("kept", "words"),
    [
        (ran(err=b"note: x\nwarning: y\n", appeared=("out.mcap",)), ""),
        (ran(1, err=b"warning: y\nerror: x\n"), ""),
        (ran(2, err=b"usage: roadperc-replay IN\n  [--x]\nroadperc-replay: error: x\n"), ""),
        (ran(None, crash="Traceback\n  File\nKeyError: 'x'"), "traceback: KeyError: 'x'"),
        (ran(139), "exit code 139"),
        (ran(1), "0 lines"),
        (ran(1, err=b"error: x\nerror: y\n"), "2 lines"),
        (ran(0, err=b"libpng warning: x\n"), "1 lines with exit code 0"),
        (ran(0, err=b"Traceback (most recent call last):\nValueError: x\n"), "a traceback"),
        (ran(2, err=b"usage: x\nerror: x\n"), "2 lines"),
        (ran(1, err=b"error: " + b"x" * 20_000 + b"\n"), "a line of 20007"),
        (ran(out=b"a\x1b[31m\n"), "stdout: control character"),
        (ran(1, err="error: \x9b\n".encode()), "stderr: control character"),
        (ran(out=b"\xff\n"), "no UTF-8"),
        (ran(out=b"topic /a\nINJECTED\n"), "begins a line of its own"),
        (ran(1, err=b"error: x\n", appeared=("out.mcap",)), "but it wrote: .mcap"),
        (ran(appeared=(".out.mcap.12.partial",)), "left behind"),
        (ran(1, err=b"error: x: Unable to allocate 3 GiB\n"), "memory: Unable to allocate"),
    ],
)
def test_the_judge_finds_each_broken_rule(kept, words):
    found = faults(kept)
    assert bool(found) == bool(words)
    assert words in " ".join(found)
