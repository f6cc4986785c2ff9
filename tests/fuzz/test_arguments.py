"""Commands with wrong arguments."""

from hypothesis import example, given
from hypothesis import strategies as st

from tests.fuzz import bases
from tests.fuzz.running import examples, folder_of, require_clear_end
from tests.fuzz.values import texts

OPTIONS = {
    "replay out.mcap result.mcap": "--start --end --frames --topic --set --only --threads --warm-up --continue --config"
    " --template --rate --labels --checkpoint-every",
    "info out.mcap": "--topic --fov --calibration --labels --recover",
    "report out.mcap": "--by --worst --html --json --markdown",
    "check out.mcap": "--criteria --init --junit",
    "compare out.mcap out.mcap": "--allow --tolerance --ignore --base-config --criteria",
    "trajectory out.mcap": "--align --delta --delta-unit",
    "lanes out.mcap": "--truth --size --pair",
    "find out.mcap": "--gap --min-seconds --peak --json",
    "sweep out.mcap --frames 1 --jobs 1": "--vary --degrade --baseline",
    "view out.mcap --foxglove-layout view.json": "--frame --worst --topic --set",
    "convert . made.mcap": "--role --layout --fov --height --rate --carla --tags --depth-coding",
    "degrade out.mcap worse.mcap": "--with --seed",
    "batch dataset out.mcap --dry-run": "--join --set --memory --timeout --retries",
    "bisect out.mcap": "--criteria --criterion --set",
    "infer out.mcap made.mcap": "--network --topic",
    "render dump --seconds 0.1": "--size --rate --scene --speed --mount --without",
}
GIVEN = sorted((command, option) for command, options in OPTIONS.items() for option in options.split())
VALUES = texts.map(lambda text: text.replace("\0", "0")) | st.sampled_from((
    "0", "-1", "1", "2.5", "1e300", "nan", "inf", "99999999999999999999", "x=", "=x", "image=", "lanes.hold_s=nan",
    "lanes.hold_s=0.5,0.6", "seed=" + "9" * 400, "a=" + "[" * 60, "0:5,5,2,2", "8x8", "0x0", "frame", "lanes", ".",
    "none.mcap", "out.mcap", "out.metrics.parquet", "/dev/null",
))  # fmt: skip
"""Only arguments that a process can have: without a null character."""


@examples
@given(st.sampled_from(GIVEN), VALUES, VALUES)
@example(("replay out.mcap result.mcap", "--set"), "seed=" + "9" * 5000, "x")
def test_a_value_of_an_option(given_option, value, more):
    command, option = given_option
    with folder_of(bases.results()) as folder:
        words = [*command.split(), f"{option}={value}"]
        require_clear_end(folder, *words, *([more] if command.startswith("find") else []))


@examples
@given(st.sampled_from(sorted({command.split()[0] for command in OPTIONS})), st.lists(VALUES, max_size=3))
def test_any_words(command, words):
    with folder_of(bases.results()) as folder:
        require_clear_end(folder, command, *words)
