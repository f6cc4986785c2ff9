"""Console sessions: text files with commands and their output, as a user sees them.

A line that begins with ``$`` is a command. The commands of this package run in this process, others in a shell.
"""

import re
import shlex
import subprocess
from importlib import import_module
from pathlib import Path

VARYING = (
    (r"─{9,}", "─" * 8),
    (r"\x1b\[[0-9;]*[A-Za-z]", ""),
    (r"\b[0-9a-f]{16}\b", "#"),
    (r"\b\d+(\.\d+)?(?= (s|ms|min|kB|MB|bytes|frames/s|times real time)\b)|(?<=byte )\d+|(?<=size_bytes.: )\d+", "#"),
    (r"^(Latency|total, ms)( +.*)", r"\1"),
    (r" +$", ""),
)
"""Colours, digests and sizes of compressed pictures, and times; their values depend on libraries or the machine."""


def repeated(recorded: Path, folder: Path, capsys, monkeypatch) -> str:
    """The text of a session whose commands ran again in a folder."""
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", "120")
    said = []
    for line in recorded.read_text("utf-8").splitlines():
        if line.startswith("$ "):
            code, out, err = _run(line[2:], capsys)
            text = out + (err.splitlines()[-1] + "\n" if code == 2 and err else err)
            said.append(f"{line}\n{text.replace(str(folder), '.')}" + (f"exit code {code}\n" if code else ""))
    text = "\n".join(said)
    for pattern, replacement in VARYING:
        text = re.sub(pattern, replacement, text, flags=re.MULTILINE)
    return text


def _run(command: str, capsys) -> tuple[int, str, str]:
    words = shlex.split(command)
    if not words[0].startswith("roadperc-"):
        return 0, subprocess.run(["sh", "-c", command], check=True, capture_output=True, text=True).stdout, ""
    capsys.readouterr()
    try:
        code = import_module(f"roadperc_stream.cli.{words[0].removeprefix('roadperc-')}").main(words[1:])
    except SystemExit as end:
        code = end.code
    return code, *capsys.readouterr()
