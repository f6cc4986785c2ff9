"""Prints what a replay would make of a log: the roles, the frames, the cameras."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Final

from rich.console import Console

from roadperc_stream.core.text import number
from roadperc_stream.info.facts import CameraFacts, LogFacts, ReplayFacts
from roadperc_stream.info.role_states import RoleState
from roadperc_stream.info.text import listed, rounded
from roadperc_stream.output.terminal import print_lines, print_table
from roadperc_stream.output.text_table import TextRow, TextTable, row

_ASIDE: Final = {"depth_calibration": "depth", "left_calibration": "left", "right_calibration": "right"}
"""Calibrations that nobody misses where the camera itself is missing."""
_CHOICES: Final = {
    "contract": "",
    "known": " (a name that other recorders use)",
    "guessed": " (guessed: no other topic fits)",
    "--topic": " (--topic)",
}


def print_replay(console: Console, facts: LogFacts) -> None:
    """What a replay would make of the log."""
    replay = facts.replay
    print_roles(console, replay.roles)
    print_lines(console, "", *_frame_lines(facts.file.whole, replay))
    print_table(console, _cameras(replay.cameras))


def print_roles(console: Console, states: Sequence[RoleState]) -> None:
    """Which topic fills which role, and what a replay does without."""
    filled = {state.role for state in states if state.state == "filled"}
    rows = tuple(row(state.role, _said(state)) for state in states if _worth_a_line(state, filled))
    headers = ("topic, or what a replay does without",)
    print_table(console, TextTable("Role", headers, rows, last_is_text=True, label_columns=18))


def _worth_a_line(state: RoleState, filled: set[str]) -> bool:
    """Whether the role is filled, or somebody may miss it."""
    if state.state != "missing" or state.candidates or state.why:
        return True
    missed_with = _ASIDE.get(state.role)
    return bool(state.cost) and (missed_with is None or missed_with in filled)


def _said(state: RoleState) -> str:
    if state.state == "filled":
        return f"{state.topic or ''}{_CHOICES[state.why]}"
    where = f" {state.topic}:" if state.topic else ""
    fault = f"{where} {state.why}" if state.why else ""
    cost = f": {state.cost}" if state.cost else ""
    could = [f"--topic {state.role}={topic}" for topic in state.candidates]
    return f"{state.state}{fault}{cost}" + (f"; could be {listed(could, 3)}" if could else "")


def _frame_lines(whole: bool, replay: ReplayFacts) -> Iterator[str]:
    if not whole:
        yield "a replay refuses the file as it is, and takes what can be read of it with --recover"
    if replay.refusal is not None:
        yield f"a replay stops: {replay.refusal}"
    if replay.reference is not None:
        skew = "" if replay.skew_s is None else f", stamps within a frame differ by up to {1000 * replay.skew_s:.1f} ms"
        yield f"{number(replay.frames, 'frame')}, one per message of role {replay.reference}{skew}"
    if replay.segments > 1:
        yield f"{replay.segments} segments: the stamps begin anew, as in another recording or a bag played in a loop"
    yield from _alone_lines(replay)
    if replay.unused:
        unused = ", ".join(f"{role} {count}" for role, count in sorted(replay.unused.items()))
        yield f"messages that belong to no frame: {unused}"
    yield from _tag_lines(replay)
    for topic, count in replay.unreadable.items():
        yield f"{topic}: {number(count, 'message')} cannot be decoded"
    for problem in replay.problems:
        yield f"first of these: {problem}"


def _alone_lines(replay: ReplayFacts) -> Iterator[str]:
    """Frames that a role leaves alone, those apart whose messages may be there and cannot be decoded."""
    unreadable = {state.role for state in replay.roles if state.topic in replay.unreadable}
    reasons = {False: "within the tolerance", True: "that is within the tolerance and can be decoded"}
    for broken, reason in reasons.items():
        alone = [f"{role} {n}" for role, n in sorted(replay.alone.items()) if (role in unreadable) is broken]
        if alone:
            yield f"frames without a message of a role {reason}: {', '.join(alone)}"


def _tag_lines(replay: ReplayFacts) -> Iterator[str]:
    if any(state.role == "segmentation" and state.state == "filled" for state in replay.roles):
        yield (
            f"tag table {replay.tag_table}"
            if replay.tag_table
            else ("no tag table is named: a replay needs one, such as --set tag_table=0.9.15")
        )


def _cameras(cameras: Iterable[CameraFacts]) -> TextTable:
    headers = ("pixels", "fx px", "baseline m", "height m", "remark")
    return TextTable("Camera", headers, tuple(map(_camera, cameras)), last_is_text=True, label_columns=18)


def _camera(found: CameraFacts) -> TextRow:
    camera, height_m = found.camera, None if found.ego_T_camera is None else found.ego_T_camera[2][3]
    remarks = [] if found.image_size in (None, (camera.width, camera.height)) else [_other_size(found)]
    remarks += [] if camera.square_pixels else [f"fy {rounded(camera.fy)}: differs from fx by more than 5 %"]
    remarks += ["not rectified"] if camera.lens is not None or camera.distortion else []
    remarks += ["no transform from ego"] if height_m is None else []
    cells = (f"{camera.width}x{camera.height}", rounded(camera.fx), rounded(camera.baseline_m), rounded(height_m))
    return row(found.role, *cells, ", ".join(remarks))


def _other_size(found: CameraFacts) -> str:
    width, height = found.image_size or (0, 0)
    return f"images of {width}x{height}"
