"""Who may import whom, and that the generated message module is the one its definition gives."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "roadperc_stream"


def imports(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from names if node.module == "roadperc_stream" else [node.module]


def sources(*folders):
    return [p for folder in folders for p in sorted((ROOT / folder).rglob("*.py")) if not p.name.endswith("_pb2.py")]


def stage_of(path):
    """The stage a module belongs to: its file, or its folder below chain/stages/."""
    return path.relative_to(PACKAGE / "chain" / "stages").parts[0].removesuffix(".py")


@pytest.mark.parametrize("path", sources("roadperc_stream/chain/stages"), ids=lambda p: p.stem)
def test_a_stage_knows_only_its_own_kind(path):
    for name in imports(path):
        parts = name.split(".")
        if parts[0] != "roadperc_stream":
            assert parts[0] in {"numpy", "scipy", "cv2"} | sys.stdlib_module_names, name
        elif parts[1:3] == ["chain", "stages"]:
            assert parts[3] == stage_of(path), f"{path.name} imports another stage: {name}"
        else:
            assert parts[1] == "core", name


def test_only_the_log_package_imports_mcap():
    users = {p.parent.name for p in sources("roadperc_stream") if any(n.split(".")[0] == "mcap" for n in imports(p))}
    assert users == {"log"}


def test_only_the_table_and_the_evaluation_know_parquet():
    users = {p.name for p in sources("roadperc_stream", "tools") if any(n.startswith("pyarrow") for n in imports(p))}
    assert users == {"tables.py"}


def test_results_are_encoded_and_drawn_without_the_chain():
    for path in sources("roadperc_stream/output"):
        assert not any(n.startswith("roadperc_stream.chain") for n in imports(path)), path


def test_core_imports_nothing_of_the_package_but_core():
    allowed = ("roadperc_stream.core", "roadperc_stream.errors")
    for path in sources("roadperc_stream/core"):
        foreign = [n for n in imports(path) if n.startswith("roadperc_stream") and not n.startswith(allowed)]
        assert not foreign, f"{path}: {foreign}"


def test_functions_of_chain_and_core_have_at_most_eight_parameters():
    for path in sources("roadperc_stream/chain", "roadperc_stream/core"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef):
                given = node.args
                count = len(given.posonlyargs) + len(given.args) + len(given.kwonlyargs)
                assert count <= 8, f"{path}: {node.name} has {count} parameters"


def test_chain_and_stages_never_see_the_truth():
    for path in sources("roadperc_stream/chain"):
        names = {node.id for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Name)}
        assert not names & {"Truth", "Sample"}, path


def test_the_package_imports_neither_tools_nor_eval():
    for path in sources("roadperc_stream"):
        assert not any(n.startswith(("roadperc_stream.tools", "roadperc_stream.eval")) for n in imports(path)), path


def test_tools_and_eval_do_not_import_each_other():
    for folder, other in (("tools", "eval"), ("eval", "tools")):
        for path in sources(folder):
            assert not any(n.startswith(f"roadperc_stream.{other}") for n in imports(path)), path


def test_the_generated_messages_are_those_of_the_definition(tmp_path):
    proto = "roadperc_stream/schemas/roadperc.proto"
    command = [sys.executable, "-m", "grpc_tools.protoc", f"--proto_path={ROOT}", f"--python_out={tmp_path}", proto]
    subprocess.run(command, cwd=ROOT, check=True, timeout=60)
    generated = (tmp_path / proto).with_name("roadperc_pb2.py").read_text()
    assert descriptor(generated) == descriptor((ROOT / proto).with_name("roadperc_pb2.py").read_text())


def descriptor(module):
    """The serialised definition: the rest of the file names the generator's version."""
    return next(line for line in module.splitlines() if "AddSerializedFile" in line)
