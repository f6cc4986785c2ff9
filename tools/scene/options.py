"""The options of a rendered scenario, and their flags, help and limits in ``roadperc-render``."""

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from math import inf
from typing import Any, Final, Literal, get_args

from roadperc_stream.errors import DumpError

Mount = tuple[float, float, float, float, float, float]
Stretch = tuple[float, float]
LaneEvent = Literal["begins", "ends", "splits", "merges"]
LaneSide = Literal["left", "right"]
Exposure = Literal["steps", "frames", "blackouts"]
SceneName = Literal["straight", "bend", "hill", "town"]
SCENES: Final[tuple[str, ...]] = get_args(SceneName)
SENSORS: Final = ("rgb", "depth", "segmentation", "right")
"""Cameras; each has a folder of its name."""
TRUTH: Final = "truth"
MOST_ASIDE_DEG: Final = 80.0
"""Largest angle of view rays from straight ahead over hills: rays must advance along the world's x axis."""
WINDING_ASIDE_DEG: Final = 56.0
"""The same limit on a road that turns by up to 30 degrees."""


@dataclass(frozen=True)
class RenderOptions:
    """All options of a scenario; the same options give the same bytes."""

    width: int = 1280
    height: int = 960
    seconds: float = 5.0
    rate_hz: float = 20.0
    scene: SceneName = "town"
    speed_mps: float = 10.0
    static: bool = False
    weave_m: float = 0.2
    tag_noise: float = 0.0
    depth_noise: float = 0.0
    rgb_noise: float = 0.0
    exposure: Exposure | None = None
    drop: float = 0.0
    jpeg: bool = False
    lidar: bool = False
    without: tuple[str, ...] = ()
    """Sensors without files, from ``SENSORS``; with ``TRUTH`` the dump has no poses either, as most recordings."""
    seed: int = 0
    path_truth: bool = False
    """Include the path and lane changes in the truth; other options imply it."""
    change_lane: LaneSide | None = None
    change_back: bool = False
    change_broken_off: bool = False
    lead_brakes: bool = False
    stop_and_go: bool = False
    lane: LaneEvent | None = None
    turn: LaneSide | None = None
    crossing_cars: bool = False
    parked_rows: bool = False
    whole_boxes: bool = False
    instances: bool = False
    worn_lines: Stretch | None = None
    """From and to, metres along the road."""
    missing_lines: Stretch | None = None
    fov_deg: float = 90.0
    mount: Mount = (1.5, 0.0, 1.4, 0.0, 0.0, 0.0)
    """Front camera in CARLA's convention: metres forward, right, up; degrees of roll, pitch up, yaw right."""
    pitch_std_deg: float = 0.0
    bumps: bool = False
    bonnet: float = 0.0
    """Share of the rows that the car's own bonnet hides, in the middle of the image."""

    @property
    def knows_path(self) -> bool:
        """Return True if the truth includes objects in the path and lane changes."""
        roads = (self.lane, self.turn, self.crossing_cars, self.parked_rows, self.worn_lines, self.missing_lines)
        return any((self.path_truth, self.change_lane, self.lead_brakes, self.stop_and_go, *roads))

    @property
    def frames(self) -> int:
        """Return the number of frames, at least one."""
        return max(round(self.seconds * self.rate_hz), 1)

    def check(self) -> None:
        """Check the options.

        Raises:
            DumpError: an option is out of range, or two options exclude each other; the message names them.
        """
        mounted = zip(MOUNT_LIMITS.items(), self.mount, strict=True)
        values: list[tuple[str, float, tuple[float, float]]] = []
        values += [("--size width", self.width, (64, 8192)), ("--size height", self.height, (48, 8192))]
        values += [
            (flag.name, getattr(self, flag.field), flag.limits)
            for group in FLAGS.values()
            for flag in group
            if flag.limits
        ]
        values += [(f"--mount {axis}", value, limits) for (axis, limits), value in mounted]
        for name, value, (low, high) in values:
            if not low <= value <= high:
                raise DumpError(f"{name} {value:g}: expected a number from {low:g} to {high:g}")
        for name, stretch in (("--worn-lines", self.worn_lines), ("--missing-lines", self.missing_lines)):
            if stretch is not None and not 0 <= stretch[0] < stretch[1] < inf:
                raise DumpError(f"{name} {stretch[0]:g},{stretch[1]:g}: expected FROM,TO with 0 <= FROM < TO")
        if not set(SENSORS) - set(self.without):
            raise DumpError("--without: no camera is left; keep at least one")
        self._check_together()

    def _check_together(self) -> None:
        """Check combinations of options."""
        follows = self.lead_brakes or self.stop_and_go
        crosses = self.turn is not None or self.crossing_cars
        changes, back = self.change_lane is not None, self.change_back or self.change_broken_off
        refused = {
            "--change-back and --change-broken-off need --change-lane": back and not changes,
            "--change-back cannot be combined with --change-broken-off": self.change_back and self.change_broken_off,
            "--lead-brakes cannot be combined with --stop-and-go": self.lead_brakes and self.stop_and_go,
            "--static cannot be combined with a lane change, a crossing or a car to follow": (
                self.static and (follows or crosses or changes)
            ),
            "--turn cannot be combined with --lead-brakes or --stop-and-go": self.turn is not None and follows,
            "--turn and --crossing-cars cannot be combined with --change-lane": crosses and changes,
            "--lane cannot be combined with --change-lane, --turn or --crossing-cars": (
                self.lane is not None and (crosses or changes)
            ),
            "--turn and --crossing-cars cannot be combined with --bumps": crosses and self.bumps,
            "--bumps cannot be combined with --scene bend": self.bumps and self.scene == "bend",
        }
        for message, wrong in refused.items():
            if wrong:
                raise DumpError(message)
        level = crosses or (self.scene in ("straight", "bend") and not self.bumps)
        beside = self.fov_deg / 2 + abs(self.mount[5])
        most = WINDING_ASIDE_DEG if self.scene == "town" else MOST_ASIDE_DEG
        if not level and beside > most:
            raise DumpError(
                f"--fov and --mount: the view reaches {beside:g} degrees to the side, expected at most {most:g} if "
                "the ground is not level; use a smaller angle, or --scene straight or bend"
            )


MOUNT_LIMITS: Final[dict[str, tuple[float, float]]] = {
    "x": (-2, 4), "y": (-1.5, 1.5), "z": (0.3, 5), "roll": (-45, 45), "pitch": (-45, 45), "yaw": (-60, 60),
}  # fmt: skip


@dataclass(frozen=True)
class Flag:
    """A flag of ``roadperc-render`` that sets a field; ``words`` are arguments of ``add_argument``."""

    name: str
    field: str
    limits: tuple[float, float] | None
    words: Mapping[str, Any]


def _numbers(text: str, form: str, example: str) -> tuple[float, ...]:
    """Return the numbers of an option; ``form`` gives their count."""
    try:
        values = tuple(float(word) for word in text.split(","))
    except ValueError:
        values = ()
    if len(values) != len(form.split(",")):
        raise argparse.ArgumentTypeError(f"{text!r}: expected {form}, such as {example}")
    return values


def _tuple(form: str, example: str) -> dict[str, Any]:
    return {"type": partial(_numbers, form=form, example=example), "metavar": form}


def _flag(name: str, text: str, **words: Any) -> Flag:
    field = name.removeprefix("--").replace("-", "_")
    value = getattr(RenderOptions, field)
    if isinstance(value, bool):
        words["action"] = "store_true"
    return Flag(name, field, None, {"help": text, "default": value, **words})


def _number(name: str, metavar: str, limits: tuple[float, float], text: str, field: str = "", **words: Any) -> Flag:
    field = field or name.removeprefix("--").replace("-", "_")
    value = getattr(RenderOptions, field)
    words = {"help": text, "default": value, "type": type(value), "metavar": metavar, **words}
    return Flag(name, field, limits, words)


_SIDES: Final = get_args(LaneSide)
_EVENTS: Final = get_args(LaneEvent)
_EXPOSURE: Final = "gain 0.5 to 2 and offset change every second (steps) or frame, or the images turn black (blackouts)"
_MOUNT: Final = (
    "pose of the front camera in CARLA's convention: metres forward, right, up; degrees of roll, pitch up, yaw right "
    "(1.5,0,1.4,0,0,0)"
)
_WHOLE: Final = "boxes of whole objects with hidden parts, like CARLA's 2D boxes, in truth.json and detections.json"
_CODING: Final = (
    "write instance_segmentation/ in CARLA's coding: red is the tag, green and blue are the id (low, high byte)"
)
_PATH: Final = "add objects in the path, times to impact and lane changes to truth.json; other options imply it"
_TURN: Final = "turn 90 degrees with a radius of 12 m at a crossing without markings, on level ground (left)"
_BONNET: Final = "the car's own bonnet hides this share of the image's rows (0.4)"
_LEFT_OUT: Final = {"action": "append", "choices": (*SENSORS, TRUTH), "metavar": "NAME", "default": None}
FLAGS: Final[Mapping[str, tuple[Flag, ...]]] = {
    "": (
        _flag("--jpeg", "rgb and right as JPEG"),
        _flag("--lidar", "add a lidar on the roof, 2.4 m high, with exact points"),
        _flag("--without", f"leave out {', '.join(SENSORS)} or {TRUTH}", **_LEFT_OUT),
        _number("--seed", "N", (0, 2**32), "seed of all random numbers (0)"),
    ),
    "scene": (
        _flag(
            "--scene", "bend: radius 150 m; hill: grades up to 8 %%; town (default): bends and hills", choices=SCENES
        ),
        _flag("--static", "keep the ego car still while others move"),
        _number("--seconds", "S", (1e-3, 86400), "length of the scenario (%(default)g)"),
        _number("--rate", "HZ", (0.1, 1000), "frames per second (%(default)g)", "rate_hz"),
        _number("--speed", "MPS", (0.5, 40), "metres per second along the road (%(default)g)", "speed_mps"),
        _number(
            "--weave", "METRES", (0, 1), "lateral amplitude of the ego car about its lane's centre (0.2)", "weave_m"
        ),
    ),
    "noise and drops": (
        _number(
            "--tag-noise", "P", (0, 0.5), "blobs of wrong classes over a share P of the image, and displaced borders"
        ),
        _number("--depth-noise", "R", (0, 0.5), "relative standard deviation of the depth"),
        _number("--rgb-noise", "STD", (0, 100), "standard deviation of the colours in grey levels"),
        _number("--drop", "P", (0, 0.95), "probability of a missing file of a sensor; the first frame is complete"),
        _flag("--exposure", _EXPOSURE, choices=get_args(Exposure)),
    ),
    "lane changes": (
        _flag("--change-lane", "change to a second lane on this side after 2 s, over 3 s", choices=_SIDES),
        _flag("--change-back", "change back after 2 s, over 3 s"),
        _flag("--change-broken-off", "abort: return before the line, in 3 s"),
    ),
    "road": (
        _flag("--turn", _TURN, nargs="?", const="left", choices=_SIDES),
        _flag("--lane", "event of a second lane on the right after 4 s, over 30 m", choices=_EVENTS),
        _flag("--crossing-cars", "add a crossing where cars cross close ahead"),
        _flag("--parked-rows", "add rows of parked cars on both sides"),
        _flag("--worn-lines", "metres of road with worn markings", **_tuple("FROM,TO", "20,50")),
        _flag("--missing-lines", "metres of road with missing markings", **_tuple("FROM,TO", "20,50")),
    ),
    "camera and pitching": (
        _number("--fov", "DEG", (20, 140), "horizontal field of view (%(default)g)", "fov_deg"),
        _flag("--mount", _MOUNT, **_tuple("X,Y,Z,ROLL,PITCH,YAW", "1.5,0,1.4,0,-3,0")),
        _number("--pitch-std", "DEG", (0, 5), "standard deviation of the car's pitching, degrees (0)", "pitch_std_deg"),
        _flag("--bumps", "add a speed bump every 30 m, 10 cm high"),
        _number("--bonnet", "SHARE", (0, 0.6), _BONNET, nargs="?", const=0.4),
    ),
    "car ahead": (
        _flag("--lead-brakes", "it brakes hard after 2 s; the ego car brakes late and nearly hits it"),
        _flag("--stop-and-go", "both cars drive, brake and stand repeatedly, in a queue"),
    ),
    "truth": (_flag("--whole-boxes", _WHOLE), _flag("--instances", _CODING), _flag("--path-truth", _PATH)),
}
"""The flags by group of the help text."""
