"""Gives the module of $ROADPERC_FAULT its faulty source when it is imported.

Python imports a `sitecustomize` on its path when it starts, so commands that tests start are faulty as well.
"""

import importlib.machinery
import json
import os
import sys
from pathlib import Path


class FaultyLoader(importlib.machinery.SourceFileLoader):
    """Compiles the faulty source and leaves no cached bytecode behind."""

    def get_code(self, fullname):
        path = self.get_filename(fullname)
        return compile(Path(FAULTY).read_text("utf-8"), path, "exec")


class FaultyFinder:
    """Lets the finders behind it find each module and takes over the loading of the faulty one."""

    @classmethod
    def find_spec(cls, fullname, path, target=None):
        for finder in sys.meta_path[sys.meta_path.index(cls) + 1 :]:
            spec = finder.find_spec(fullname, path, target)
            if spec is not None:
                if spec.origin is not None and os.path.realpath(spec.origin) == SOUND:
                    spec.loader = FaultyLoader(spec.name, spec.origin)
                return spec
        return None


if "ROADPERC_FAULT" in os.environ:
    SOUND, FAULTY = json.loads(os.environ["ROADPERC_FAULT"])
    sys.meta_path.insert(0, FaultyFinder)
