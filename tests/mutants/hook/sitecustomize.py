"""Puts the fault of $ROADPERC_FAULT into its module as it is imported; found by every Python below a trial.

Python imports a `sitecustomize` on its path as it starts, so that commands which tests start are faulty as well.
"""

import importlib.abc
import importlib.machinery
import importlib.util
import json
import os
import sys
from pathlib import Path


class FaultyLoader(importlib.machinery.SourceFileLoader):
    """Compiles a module with the fault in it and leaves neither source nor cached bytecode behind."""

    def __init__(self, name: str, path: str, place: int, choice: int) -> None:
        super().__init__(name, path)
        self.fault = place, choice

    def get_code(self, fullname):
        path = Path(self.get_filename(fullname))
        return compile(_faults().faulty(path.read_text("utf-8"), *self.fault), str(path), "exec")


class FaultyFinder(importlib.abc.MetaPathFinder):
    """Lets the finders behind it find each module and takes over the loading of the faulty one."""

    def __init__(self, path: str, place: int, choice: int) -> None:
        self.path, self.place, self.choice = os.path.realpath(path), place, choice

    def find_spec(self, fullname, path, target=None):
        for finder in sys.meta_path[sys.meta_path.index(self) + 1 :]:
            spec = finder.find_spec(fullname, path, target)
            if spec is not None:
                break
        else:
            return None
        if spec.origin is not None and os.path.realpath(spec.origin) == self.path:
            spec.loader = FaultyLoader(spec.name, spec.origin, self.place, self.choice)
        return spec


def _faults():
    """`tests.mutants.faults` by its path: a command that a test starts may see no `tests` package."""
    spec = importlib.util.spec_from_file_location("_faults", Path(__file__).parents[1] / "faults.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def install(told: str) -> None:
    """Makes the module faulty that `told` names: JSON of path, place and choice."""
    sys.meta_path.insert(0, FaultyFinder(*json.loads(told)))


if "ROADPERC_FAULT" in os.environ:
    install(os.environ["ROADPERC_FAULT"])
