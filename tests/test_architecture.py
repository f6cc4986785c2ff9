"""Rules for imports between packages, and for the generated message module."""

import ast
import re
import subprocess
import sys
import tomllib
from collections import Counter
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
from packaging.version import Version

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "roadperc_stream"
GENERATED = PACKAGE / "schemas" / "roadperc_pb2.py"

DATA = {"errors", "kernels", "geometry", "model"}
BELOW = DATA | {"schemas", "config", "system"}
INPUT = BELOW | {"formats", "log"}
FRAME = INPUT | {"input", "chain", "metrics", "output"}
REPLAY = FRAME | {"resume", "loop"}
MAY_IMPORT = {
    "errors": set(),
    "kernels": set(),
    "geometry": {"errors", "kernels"},
    "model": DATA - {"model"},
    "system": {"errors"},
    "schemas": DATA | {"system"},
    "config": DATA | {"schemas", "system"},
    "formats": BELOW,
    "log": BELOW,
    "chain": BELOW - {"schemas"},
    "metrics": BELOW | {"chain"},
    "input": INPUT,
    "output": INPUT | {"input", "metrics"},
    "resume": FRAME,
    "loop": FRAME | {"resume"},
    "api": REPLAY,
    "info": INPUT | {"input", "output"},
    "view": INPUT | {"input", "output"},
    "batch": REPLAY | {"info"},
    "cli": REPLAY | {"batch", "info", "view", "tools", "eval"},
}
"""Allowed imports of each folder and root module; of the package only commands import tools and eval."""
STAGES_MAY_IMPORT = {"errors", "model", "geometry", "config", "kernels", "system.time", "numpy", "scipy", "cv2"}
MOST_ROOT_MODULES = 4
LONGEST_CHAIN = 15
LONGEST_IMPORT_CHAIN = 24
"""Modules, starting at the loop."""


def sources(*folders):
    """The modules below the folders, without generated ones."""
    found = {folder: sorted((ROOT / folder).rglob("*.py")) for folder in folders}
    assert all(found.values()), "a folder without modules: was it renamed?"
    return [path for paths in found.values() for path in paths if not path.name.endswith("_pb2.py")]


@cache
def nodes(path):
    """All nodes of a module's syntax tree."""
    return list(ast.walk(ast.parse(path.read_text())))


@cache
def imports(path):
    """Full names of the imports of a module; the package's own modules without its name, as ``system.files``."""
    found = set()
    for node in nodes(path):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.update(own_or_member(node.module, alias.name) for alias in node.names)
    return frozenset(name.removeprefix("roadperc_stream.") for name in found if name != "roadperc_stream")


def own_or_member(module, name):
    """The module of an imported name, or the name itself if it is a module."""
    path = PACKAGE.joinpath(*module.split(".")[1:], name)
    is_module = module.startswith("roadperc_stream") and (path.is_dir() or path.with_suffix(".py").is_file())
    return f"{module}.{name}" if is_module else module


def module_of(path):
    return ".".join(path.relative_to(PACKAGE).with_suffix("").parts)


def part_of(module):
    """The part of a module: its folder or itself at the root."""
    return module.partition(".")[0]


def crossings():
    """(module, imported part) of all imports between parts."""
    parts = {*MAY_IMPORT, "tools", "eval"}
    for path in sources("roadperc_stream"):
        module = module_of(path)
        for part in {part_of(name) for name in imports(path)} & parts - {part_of(module)}:
            yield module, part


def test_every_part_has_a_rule():
    parts = {path.stem for path in PACKAGE.iterdir() if path.suffix == ".py" or (path / "__init__.py").is_file()}
    parts -= {path.name for path in PACKAGE.iterdir() if path.is_symlink()}  # eval and tools
    assert parts - {"__init__"} == set(MAY_IMPORT)


def test_parts_import_only_allowed_parts():
    wrong = {(m, part) for m, part in crossings() if m != "__init__" and part not in MAY_IMPORT[part_of(m)]}
    assert wrong == set()


def test_imports_between_parts_have_no_cycle_and_no_long_chain():
    edges = {part: set() for part in MAY_IMPORT}
    for module, part in crossings():
        edges.setdefault(part_of(module), set()).add(part)
    length = {}
    for part in TopologicalSorter(edges).static_order():  # raises CycleError
        length[part] = 1 + max((length[below] for below in edges.get(part, ())), default=0)
    assert max(length.values()) <= LONGEST_CHAIN


def test_the_import_chain_of_the_loop_is_short():
    modules = [path for path in sources("roadperc_stream") if path != PACKAGE / "__init__.py"]
    edges = {module_of(path).removesuffix(".__init__"): imported_at_head(path) for path in modules}
    length = {}
    for module in TopologicalSorter(edges).static_order():  # raises CycleError
        length[module] = 1 + max((length[below] for below in edges.get(module, ())), default=0)
    assert length["loop"] <= LONGEST_IMPORT_CHAIN


def imported_at_head(path):
    """Modules of the package that a module imports at its head, without the packages that contain it."""
    found = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ImportFrom) and node.module.split(".")[0] == PACKAGE.name:
            found |= {node.module, *(own_or_member(node.module, alias.name) for alias in node.names)}
    around = {PACKAGE.name, *(module_of(folder) for folder in path.parents[:-1] if PACKAGE in folder.parents)}
    return {name.removeprefix("roadperc_stream.") for name in found} - around


def test_the_root_has_few_modules():
    assert len(list(PACKAGE.glob("*.py"))) <= MOST_ROOT_MODULES


def test_public_classes_have_unique_names():
    paths = sources("roadperc_stream", "tools", "eval")
    names = Counter(node.name for path in paths for node in nodes(path) if isinstance(node, ast.ClassDef))
    assert {n for n, count in names.items() if count > 1 and not n.startswith("_")} == set()


def test_a_stage_does_not_import_other_stages():
    for path in sources("roadperc_stream/chain/stages"):
        own = f"chain.stages.{module_of(path).split('.')[2]}"
        for name in imports(path):
            known = {name, part_of(name)} & STAGES_MAY_IMPORT or name.split(".")[0] in sys.stdlib_module_names
            assert known or f"{name}.".startswith(f"{own}."), f"{path.name} imports {name}"


@pytest.mark.parametrize(
    ("library", "folders", "expected"),
    [
        ("mcap", ["roadperc_stream"], {f"roadperc_stream/log/{path.name}" for path in (PACKAGE / "log").glob("*.py")}),
        ("ray", ["roadperc_stream"], {"roadperc_stream/batch/cluster.py"}),
        # Parquet, object stores, and the report benchmark
        (
            "pyarrow",
            ["roadperc_stream", "tools"],
            {"roadperc_stream/output/tables.py", "roadperc_stream/batch/stores.py", "tools/bench/report.py"},
        ),
    ],
)
def test_few_modules_import_a_library(library, folders, expected):
    users = {path for path in sources(*folders) if library in {name.split(".")[0] for name in imports(path)}}
    assert users
    assert {path.relative_to(ROOT).as_posix() for path in users} <= expected


def test_functions_have_at_most_eight_parameters():
    """Except rp.replay, which takes all options of a replay by keyword."""
    many = set()
    for path in sources("roadperc_stream", "tools", "eval"):
        for node in nodes(path):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                given = node.args
                if len(given.posonlyargs) + len(given.args) + len(given.kwonlyargs) > 8:
                    many.add((path.name, node.name))
    assert many == {("api.py", "replay")}


def test_the_loop_is_short():
    """Functions of the loop, of writing and of resuming take at most six arguments, five of them positional."""
    assert len((PACKAGE / "loop.py").read_text().splitlines()) <= 150
    for path in (PACKAGE / "loop.py", PACKAGE / "output" / "writing.py", *sources("roadperc_stream/resume")):
        for node in nodes(path):
            if isinstance(node, ast.FunctionDef):
                assert len(node.args.args) + len(node.args.kwonlyargs) <= 6, f"{path.name}: {node.name}"
            if isinstance(node, ast.Call):
                assert len(node.args) <= 5, f"{path.name}, line {node.lineno}"


def test_resume_imports_no_stage():
    for path in sources("roadperc_stream/resume"):
        assert not [name for name in imports(path) if name.startswith(("chain.stages", "kernels"))], path.name


def test_the_chain_does_not_use_the_truth():
    for path in sources("roadperc_stream/chain"):
        names = {node.id for node in nodes(path) if isinstance(node, ast.Name)}
        assert not names & {"Truth", "Sample"}, path


def test_tools_do_not_import_eval():
    for path in sources("tools"):
        assert "eval" not in {part_of(name) for name in imports(path)}, path


def test_the_generated_messages_match_their_definition(tmp_path):
    proto = "roadperc_stream/schemas/roadperc.proto"
    command = [sys.executable, "-m", "grpc_tools.protoc", f"--proto_path={ROOT}", f"--python_out={tmp_path}", proto]
    subprocess.run(command, cwd=ROOT, check=True, timeout=60)
    assert (tmp_path / proto).with_name(GENERATED.name).read_text() == GENERATED.read_text()


def test_the_generated_messages_load_with_the_lowest_declared_protobuf():
    """Generated code does not load with a protobuf older than its generator."""
    (lowest,) = re.findall(r'"protobuf>=([\d.]+)', (ROOT / "pyproject.toml").read_text())
    (generator,) = re.findall(r"Protobuf Python Version: ([\d.]+)", GENERATED.read_text())
    assert Version(generator) <= Version(lowest)


def test_every_package_of_the_code_is_installed():
    """An editable installation also finds packages missing from the list. The wheel excludes only the benchmark."""
    installed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    folders = {path.parent.relative_to(ROOT) for path in sources("roadperc_stream", "eval", "tools")}
    folders.remove(Path("tools/bench"))
    inside = {folder if folder.parts[0] == PACKAGE.name else PACKAGE.name / folder for folder in folders}
    assert sorted(installed) == sorted(".".join(folder.parts) for folder in inside)
