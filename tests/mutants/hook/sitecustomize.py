"""Import hook: loads the module named by $ROADPERC_FAULT from its faulty source.

Python imports `sitecustomize` from its path at start, so commands that tests start have the fault too.
"""

import importlib.machinery
import json
import os
import sys
from pathlib import Path


class FaultyLoader(importlib.machinery.SourceFileLoader):
    """Compiles the faulty source without writing cached bytecode."""

    def get_code(self, fullname):
        path = self.get_filename(fullname)
        return compile(Path(FAULTY).read_text("utf-8"), path, "exec")


class FaultyFinder:
    """Finds modules with the other finders and loads the faulty one."""

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
