"""Writes docs/errors.md: frequent errors as the commands print them, with meaning and remedy.

``python -m tests.errors_page`` runs each command on a small broken input and writes the page; ``make pages`` calls it.
"""

import re
import shutil
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from roadperc_stream.log import LogWriter
from tests import logs
from tests.commands import run_forked

PAGE = Path(__file__).parents[1] / "docs" / "errors.md"
HEAD = """# When something goes wrong

Check a log first: `roadperc-info in.mcap` shows its channels, the role of each topic, and any damage.

An error is one line on stderr, and the exit code is 1, or 3 in `roadperc-bisect`, `roadperc-check` and
`roadperc-compare`.
Wrong usage prints the usage as well and has exit code 2.
A failed command leaves no partial output. Notes and warnings do not change the exit code.

The entries below show a command on a broken input and the line that it prints. `make pages` generates this page.
"""


@dataclass(frozen=True)
class Entry:
    """A frequent error: a heading, the command that causes it, its meaning, and what to do."""

    title: str
    command: str
    meaning: str
    action: str


ENTRIES = (
    Entry("Wrong path", "roadperc-replay drive.mcap out.mcap", "The input does not exist.", "Check the path."),
    Entry(
        "Existing output", "roadperc-replay in.mcap result.mcap", "The output exists.",
        "Choose another name, or pass `--force` to replace it.",
    ),
    Entry(
        "Input and output are the same file", "roadperc-replay in.mcap in.mcap --force",
        "The command never overwrites its input.", "Name another output.",
    ),
    Entry(
        "Not an MCAP log", "roadperc-replay cut_off.mp4 out.mcap", "The file has another format.",
        "Convert videos and folders of frames with `roadperc-convert`. ROS bags are replayed directly.",
    ),
    Entry(
        "Cut or damaged log", "roadperc-replay cut.mcap out.mcap", "The recording ended early, or the copy is damaged.",
        "Copy the file again, or pass `--recover` to use the intact messages.",
    ),
    Entry(
        "Log without images", "roadperc-replay empty_bag.mcap out.mcap", "No topic has a type that the chain reads.",
        "List the topics with `roadperc-info`. Record images, depth or segmentation.",
    ),
    Entry(
        "Missing calibration", "roadperc-replay no_calibration.mcap out.mcap",
        "The chain cannot use an image without its camera's calibration.",
        "Record the calibration topic, or name it with `--topic calibration=/TOPIC`. "
        "If the log has none, give it: [logs without a calibration](recordings.md#logs-without-a-calibration). "
        "Pass all files of a split log together.",
    ),
    Entry(
        "Unknown topic", "roadperc-replay in.mcap out.mcap --topic image=/front", "The log has no such topic.",
        "Use one of the listed topics.",
    ),
    Entry(
        "Unknown role", "roadperc-replay in.mcap out.mcap --topic imge=/camera/front/image",
        "The name before `=` is not a role.", "Use one of the listed roles.",
    ),
    Entry(
        "Frames without segmentation", "roadperc-report no_segmentation.out.mcap --full",
        "Stages without their inputs have no output. The other stages run.",
        "Record segmentation if you need lanes and filtered detections.",
    ),
    Entry(
        "No tag table", "roadperc-replay no_tags.mcap result3.mcap",
        "The meaning of the segmentation's tags is unknown, so the images are not used.",
        "Set `tag_table` to the CARLA version of the recording.",
    ),
    Entry(
        "Time range without frames", "roadperc-replay in.mcap out.mcap --start 60",
        "The log is shorter than the start time.", "Choose a start within the log.",
    ),
    Entry(
        "Unknown option", "roadperc-replay in.mcap out.mcap --sett lanes.hold_s=1", "The option does not exist.",
        "List the options with `roadperc-replay --help`.",
    ),
    Entry(
        "Unknown stage", "roadperc-replay in.mcap out.mcap --only lane", "The stage does not exist.",
        "Use the listed names, separated by commas.",
    ),
    Entry(
        "Unknown setting", "roadperc-replay in.mcap out.mcap --set lanes.hold=1", "The setting does not exist.",
        "List all settings with `roadperc-replay --list-settings`.",
    ),
    Entry(
        "Setting out of range", "roadperc-replay in.mcap out.mcap --set lanes.hold_s=-1",
        "The value is outside the allowed range.", "Choose a value in the printed range.",
    ),
    Entry(
        "Own stage without its module", "roadperc-replay in.mcap out.mcap --set lanes.implementation=my_lanes:MyLanes",
        "Python does not find the code of a stage of your own.",
        "Run the command in the folder of `my_lanes.py`, or install the package ([A stage of your own](own_stage.md)).",
    ),
    Entry(
        "Configuration with a syntax error", "roadperc-replay in.mcap out.mcap --config broken.toml",
        "The file is not valid TOML.", "Start from the output of `roadperc-replay --print-config`.",
    ),
    Entry(
        "Dump without calibration", "roadperc-convert drive in2.mcap", "The field of view of the camera is unknown.",
        "Add `calibration.json`, or pass `--fov` in degrees.",
    ),
    Entry(
        "Video that cannot be read", "roadperc-convert cut_off.mp4 in2.mcap --fov 55",
        "The file is no video, or the recorder was switched off before it wrote the index of the MP4.",
        "Repair the file with the tool of the camera, or record Matroska (`.mkv`), which can be read up to a cut. "
        "If OpenCV does not decode the codec, for example AV1, encode the video as H.264.",
    ),
    Entry(
        "Network without its model", "roadperc-infer in.mcap in2.mcap --network twinlitenet.toml",
        "The `.onnx` file is not beside the TOML file that names it.",
        "Download it into the same folder ([Networks of your own](networks.md)).",
    ),
    Entry(
        "Wrong folder layout", "roadperc-convert empty_folder in2.mcap", "The folder has no images with known names.",
        "Arrange the frames as in [your own recordings](recordings.md), or pass `--role`.",
    ),
    Entry(
        "Misspelled key in `calibration.json`", "roadperc-convert misspelled in2.mcap", "The key does not exist.",
        "Correct the key.",
    ),
    Entry(
        "Wrong metrics file", "roadperc-report result.objects.parquet", "The table has one row per object.",
        "Pass the file with one row per frame: `result.metrics.parquet`.",
    ),
    Entry(
        "Log without metrics", "roadperc-report in.mcap", "The log is an input, so it has no metrics table.",
        "Replay the log, and pass the result.",
    ),
    Entry(
        "Missing truth", "roadperc-trajectory result.mcap", "The log has no true poses.",
        "Record `/truth/pose`. Without truth, export the poses with `--export-tum` or `--export-kitti`.",
    ),
    Entry(
        "No results to view", "roadperc-view in.mcap --video out.mp4", "The log is an input.",
        "Replay the log, and pass the result.",
    ),
)  # fmt: skip


def make_inputs(folder: Path) -> None:
    """Write the broken inputs of all entries into a folder."""
    _write(folder / "in.mcap", logs.ALL)
    _write(folder / "no_calibration.mcap", ("tf", "image", "depth"))
    _write(folder / "no_segmentation.mcap", logs.ALL, skipped=("segmentation",))
    _write(folder / "no_tags.mcap", logs.ALL, metadata=())
    with LogWriter(folder / "empty_bag.mcap") as writer:
        writer.write(logs.foreign())
    (folder / "cut.mcap").write_bytes((folder / "in.mcap").read_bytes()[:-3000])
    (folder / "notes.mcap").write_text("no log")
    shutil.copy(PAGE.parent / "networks" / "twinlitenet.toml", folder)
    (folder / "broken.toml").write_text("[lanes\n")
    (folder / "empty_folder").mkdir()
    (folder / "cut_off.mp4").write_bytes(b"\0\0\0\x1cftypisom\0\0\2\0isomiso2mp41")
    for name, calibration in (("drive", "{}"), ("misspelled", '{"widht": 16, "height": 12, "fov_deg": 90}')):
        (folder / name / "rgb").mkdir(parents=True)
        cv2.imwrite(str(folder / name / "rgb" / "1.png"), np.zeros((12, 16, 3), np.uint8))
        (folder / name / "calibration.json").write_text(calibration)
    run_forked("roadperc-replay", "in.mcap", "result.mcap", cwd=folder)
    run_forked("roadperc-replay", "no_segmentation.mcap", "no_segmentation.out.mcap", cwd=folder)


def _write(path: Path, roles: tuple[str, ...], skipped: tuple[str, ...] = (), **labels: object) -> None:
    """Write a log of three frames; the roles in `skipped` have messages in the first frame only."""
    with LogWriter(path) as writer:
        for sequence, item in enumerate(logs.items(3, roles=roles)):
            if item.role not in skipped or item.stamp_ns == logs.START_NS:
                message = logs.message(item, sequence)
                writer.write(replace(message, channel=replace(message.channel, **labels)))


def printed(entry: Entry, folder: Path) -> str:
    """The error of a command: its last line on stderr, or its notes and reasons if it succeeds."""
    done = run_forked(*entry.command.split(), cwd=folder)
    if done.returncode:
        return done.stderr.strip().splitlines()[-1]
    return "\n".join(line.rstrip() for line in done.stdout.splitlines() if re.search("^(note|warning):|no segm", line))


def page() -> str:
    """The whole page."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_inputs(folder)
        return HEAD + "".join(_part(entry, printed(entry, folder)) for entry in ENTRIES)


def _part(entry: Entry, text: str) -> str:
    return f"\n## {entry.title}\n\n```text\n$ {entry.command}\n{text}\n```\n\n{entry.meaning} {entry.action}\n"


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
