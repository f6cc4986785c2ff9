"""A second opinion on the logs that are written: MCAP's own TypeScript reader, where Node has it.

The program is looked for as ``mcap-validate/validate.mjs`` in the folder ``tools`` beside the recordings.
"""

import json
import os
import shutil
import subprocess
from functools import cache
from pathlib import Path

from tests.conftest import DEFAULT_DATA
from tests.fuzz import bounds
from tests.fuzz.judge import kind_of_message

PATIENCE_S = 60


@cache
def program() -> Path | None:
    """The validator; None where it, its libraries or Node are missing."""
    data = Path(os.environ.get("ROADPERC_DATA", DEFAULT_DATA))
    path = data.parent / "tools" / "mcap-validate" / "validate.mjs"
    there = shutil.which("node") and path.is_file() and (path.parent / "node_modules").is_dir()
    return path if there else None


def damages(log: Path) -> list[str]:
    """What the validator finds wrong with a log; what stands in the input's messages, which are copied, is not."""
    path = program()
    if path is None:
        return []
    done = subprocess.run(
        ["node", path, "--json", log], capture_output=True, check=False, timeout=PATIENCE_S,
        preexec_fn=bounds.lift_limit,  # Node alone takes ten gigabytes of address space
    )  # fmt: skip
    try:
        found = json.loads(done.stdout)
    except ValueError:
        return [f"validator: {kind_of_message(done.stderr.decode('utf-8', 'replace'))}"]
    copied = tuple(c["topic"] for c in found.get("channels", ()) if not c["topic"].startswith("/perception/"))
    return [f"validator: {kind_of_message(text)}" for text in found["problems"] if not text.startswith(copied)]
