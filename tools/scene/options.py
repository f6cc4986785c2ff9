"""The options of a rendered scenario."""

from dataclasses import dataclass
from math import inf
from typing import Final, Literal, get_args

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

MOUNT_NAMES: Final = tuple(f"--mount {axis}" for axis in ("x", "y", "z", "roll", "pitch", "yaw"))
MOST_ASIDE_DEG: Final = 80.0
"""Largest angle of view rays from straight ahead over hills: rays must advance along the world's x axis."""
WINDING_ASIDE_DEG: Final = 56.0
"""The same limit on a road that turns by up to 30 degrees."""
PATH_OPTIONS: Final = (
    "path_truth",
    "change_lane",
    "lead_brakes",
    "stop_and_go",
    "lane",
    "turn",
    "crossing_cars",
    "parked_rows",
    "worn_lines",
    "missing_lines",
)
"""With any of these options the truth includes objects in the path and lane changes."""


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
    """Sensors without files, from ``SENSORS``."""
    seed: int = 0
    path_truth: bool = False
    """Include the path and lane changes in the truth; every one of ``PATH_OPTIONS`` implies it."""
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
        return any(getattr(self, name) for name in PATH_OPTIONS)

    @property
    def frames(self) -> int:
        """Return the number of frames, at least one."""
        return max(round(self.seconds * self.rate_hz), 1)

    def check(self) -> None:
        """Check the options.

        Raises:
            DumpError: an option is out of range, or two options exclude each other; the message names them.
        """
        limits: tuple[tuple[str, float, float, float], ...] = (
            ("--size width", self.width, 64, 8192),
            ("--size height", self.height, 48, 8192),
            ("--seconds", self.seconds, 1e-3, 86400),
            ("--rate", self.rate_hz, 0.1, 1000),
            ("--speed", self.speed_mps, 0.5, 40),
            ("--weave", self.weave_m, 0, 1.0),
            ("--tag-noise", self.tag_noise, 0, 0.5),
            ("--depth-noise", self.depth_noise, 0, 0.5),
            ("--rgb-noise", self.rgb_noise, 0, 100),
            ("--drop", self.drop, 0, 0.95),
            ("--seed", self.seed, 0, 2**32),
            ("--fov", self.fov_deg, 20, 140),
            ("--pitch-std", self.pitch_std_deg, 0, 5),
            ("--bonnet", self.bonnet, 0, 0.6),
            *zip(MOUNT_NAMES, self.mount, (-2, -1.5, 0.3, -45, -45, -60), (4, 1.5, 5, 45, 45, 60), strict=True),
        )
        for name, value, low, high in limits:
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
