"""The scenes and recordings of the figures, and the options of their replays."""

import os
from dataclasses import dataclass

from tests import course
from tests.accuracy.drives import ROOT, CoursePair, Drive, Excerpt, Noise, drive
from tests.conftest import DEFAULT_DATA

CLEAN, MODEST, HEAVY, TAGS = Noise(), Noise(0.02, 0.01), Noise(0.05, 0.02), Noise(0.02)
LEVELS = {"1+2 %": MODEST, "2+5 %": HEAVY}
"""By the noise of depth and tags."""
MOTION = "surface,odometry"
LANES = "surface,odometry,lanes"
OBJECTS = "surface,odometry,lanes,objects"
MODELS = ("plane", "spline", "auto")
DATA = os.environ.get("ROADPERC_DATA", str(DEFAULT_DATA))
SAMPLE = str(ROOT / "logs" / "sample.mcap")
ONE_CAMERA = {"without": ("depth", "right"), "fov_deg": 70.0}
SMALL = {"width": 320, "height": 240}


@dataclass(frozen=True)
class Scenario:
    """A drive under a kind of noise, or a recording (a log, a folder, or frames of one), replayed with some stages."""

    name: str
    source: Drive | Excerpt | CoursePair | str
    noise: Noise = CLEAN
    only: str = ""
    settings: tuple[str, ...] = ()
    template: str = ""

    @property
    def scene(self):
        """The rendered scene; the scenario's name for a recording."""
        return self.source.options.scene if isinstance(self.source, Drive) else self.name


def replays(drives, noise, only, name="{}"):
    """Scenarios of some drives; ``name`` is a format for the drive's name."""
    return tuple(Scenario(name.format(of.name), of, noise, only) for of in drives)


def tilted(name, scene, pitch_deg, **options):
    """A drive with one camera whose pitch the log does not say."""
    mount = (1.5, 0.0, 1.4, 0.0, pitch_deg, 0.0)
    return drive(name, scene=scene, mount=mount, pitch_is_unknown=True, **(ONE_CAMERA | options))


def of_town(name, seeds=1.0, **options):
    """A drive of 8 s in the town."""
    return drive(name, seeds, **({"scene": "town", "rate_hz": 5.0, "seconds": 8.0} | options))


CHANGES = (
    drive("change-left-back", scene="bend", change_lane="left", change_back=True, seconds=11.0),
    drive("change-right", scene="town", change_lane="right", seconds=6.5),
    drive("change-broken-off", scene="straight", change_lane="left", change_broken_off=True, seconds=6.0),
)
BEND = drive("bend", scene="bend", weave_m=0.5, seconds=4.0)
COMPARED = (CHANGES[1], BEND)
"""The scenes of the noise comparison."""
CHANGED = replays(CHANGES, MODEST, LANES)
TURNED = replays(
    (drive(f"whole-turn-{side}", scene="town", turn=side, seconds=11.0) for side in ("left", "right")), MODEST, LANES
)
BY_TAG_NOISE = {
    level: replays(COMPARED, Noise(level / 100, 0.01), LANES, f"tags {level} %, {{}}") for level in (0, 5, 10, 20, 40)
}
BY_JPEG = {
    quality: replays(COMPARED, Noise(jpeg_quality=quality), LANES, f"jpeg {quality}, {{}}") for quality in (95, 75)
}
WITHOUT_DEPTH = replays(COMPARED, Noise(0.02, 0.3), LANES, "depth 30 %, {}")
AT_TWO_HZ = (Scenario("2 Hz", drive("two-hz", scene="bend", weave_m=0.5, rate_hz=2.0, seconds=15.0), MODEST, LANES),)
BEHIND_BONNET = tuple(
    Scenario(name, drive(name, scene="bend", bonnet=0.4, seconds=3.0, without=without), noise, LANES)
    for name, without, noise in (("bonnet", ("right",), MODEST), ("bonnet-alone", ("right", "depth"), TAGS))
)
ONE_BY_ONE = replays(
    (
        tilted(f"still-{pitch_deg}", scene, pitch_deg, rate_hz=0.2, seconds=20.0, fov_deg=55.0)
        for pitch_deg, scene in (
            (-6.0, "straight"),
            (-3.0, "bend"),
            (0.0, "straight"),
            (3.0, "bend"),
            (6.0, "straight"),
        )
    ),
    TAGS,
    LANES,
)
COURSE_FRAMES = (Scenario("course frames", f"{DATA}/course_frames"),)

ROADS = {"hill": drive("hill", scene="hill", rate_hz=2.0, seconds=8.0), "bend": BEND, "sample": SAMPLE}
BY_MODEL = {
    (road, model): (
        Scenario(f"{road}, {model}", of, CLEAN if of == SAMPLE else MODEST, LANES, (f"surface.model={model}",)),
    )
    for road, of in ROADS.items()
    for model in MODELS
}
SPARSE = replays(
    (
        drive(f"lidar-{scene}", scene=scene, lidar=True, weave_m=0.5, seconds=4.0, without=("right", "depth"))
        for scene in ("bend", "town")
    ),
    TAGS,
    LANES,
)

KITTI = f"{DATA}/kitti_odometry"
KITTI_WAYS = {
    name: (Scenario(f"kitti, {name}", KITTI if step == 1 else Excerpt(KITTI, step), only=MOTION),)
    for name, step in (("forwards", 1), ("backwards", -1), ("every second frame", 2))
}
ALONE_TURN = (
    Scenario(
        "one camera, turn",
        drive("alone-turn", scene="town", turn="left", seconds=12.0, speed_mps=6.0, **SMALL, **ONE_CAMERA),
        TAGS,
        MOTION,
    ),
)
TILTED = replays(
    (
        tilted(f"tilted-{scene}", scene, pitch_deg, seconds=6.0, **SMALL)
        for scene, pitch_deg in (("straight", -3.0), ("bend", 3.0))
    ),
    TAGS,
    MOTION,
)
AT_WIDE_BASELINES = tuple(
    tuple(
        Scenario(
            f"wide-turn-{side}, {features}",
            drive(f"wide-turn-{side}", scene="town", turn=side, rate_hz=2.0, seconds=12.0, speed_mps=5.0),
            CLEAN,
            MOTION,
            (f"odometry.features={features}",),
        )
        for side in ("left", "right")
    )
    for features in ("orb", "klt")
)
"""Turns with ORB alone, and with the default features."""
EXPOSURES = {
    kind: (
        Scenario(
            f"exposure {kind}",
            drive(f"exposure-{kind}", scene="town", exposure=kind, rate_hz=rate_hz, seconds=3.0, **SMALL),
            MODEST,
            MOTION,
        ),
    )
    for kind, rate_hz in (("steps", 10.0), ("frames", 10.0), ("blackouts", 20.0))
}

STANDARD = (Scenario("sample", SAMPLE),)
TOWN = of_town("town", 2.5, path_truth=True)
TOWNS = {level: (Scenario(f"town, {level}", TOWN, noise, OBJECTS),) for level, noise in LEVELS.items()}
LANE_TOWNS = {
    f"{rate:g} Hz, noise {level}": replays((of,), noise, LANES, f"{{}}, lanes, {level}")
    for rate, of in (
        (5.0, TOWN),
        (10.0, drive("town-10", 3.0, scene="town", seconds=5.0)),
        (20.0, drive("town-20", 1.5, scene="town", rate_hz=20.0, seconds=4.0)),
    )
    for level, noise in LEVELS.items()
}
NOISY_TOWNS = {
    level: (Scenario(f"town, tags {level} %", TOWN, Noise(level / 100, 0.01), OBJECTS),) for level in (10, 20)
}
WHOLE = of_town("town-whole", 2.0, path_truth=True, whole_boxes=True)
WHOLE_BOXES = {
    level: (Scenario(f"town, whole boxes, {level}", WHOLE, noise, OBJECTS),) for level, noise in LEVELS.items()
}
PARKED = {
    kind: (
        Scenario(
            f"parked rows, {kind}",
            of_town(f"parked-{kind}", parked_rows=True, whole_boxes=kind == "whole", seconds=6.0),
            MODEST,
            OBJECTS,
        ),
    )
    for kind in ("seen", "whole")
}
OTHER_DEPTH = {
    "stereo": {"without": ("depth",)},
    "lidar": {"lidar": True, "without": ("right", "depth")},
}
WITHOUT_DEPTH_CAMERA = {
    kind: replays(
        (
            drive(f"alone-{kind}-town", scene="town", path_truth=True, seconds=4.0, **sensors),
            drive(f"alone-{kind}-bend", scene="bend", path_truth=True, seconds=4.0, **sensors),
            drive(f"alone-{kind}-lead", scene="straight", lead_brakes=True, **sensors),
        ),
        TAGS,
        f"stereo,{OBJECTS}",
        f"{{}}, {kind} alone",
    )
    for kind, sensors in OTHER_DEPTH.items()
}
WITHOUT_TAGS = {"only": "surface,objects"}
UNTAGGED = {
    "depth": (
        Scenario(
            "no tags, depth",
            of_town("untagged", rate_hz=1.25, without=("right", "segmentation")),
            Noise(depth=0.01),
            **WITHOUT_TAGS,
        ),
    ),
    "lidar": (
        Scenario(
            "no tags, lidar",
            of_town("untagged-lidar", rate_hz=1.25, lidar=True, without=("right", "segmentation", "depth")),
            **WITHOUT_TAGS,
        ),
    ),
    "KITTI": (Scenario("kitti object", f"{DATA}/kitti_object", **WITHOUT_TAGS),),
}
TURNING = (Scenario("turn", drive("turn", scene="town", turn="right", path_truth=True, seconds=6.0), MODEST, OBJECTS),)
MERGING = (
    Scenario("merge", drive("merge", scene="bend", lane="merges", path_truth=True, seconds=8.0), MODEST, OBJECTS),
)
LEADS = tuple(drive(f"lead-{scene}", scene=scene, lead_brakes=True, seconds=5.0) for scene in ("straight", "bend"))
BRAKING = {level: replays(LEADS, noise, OBJECTS, f"{{}}, {level}") for level, noise in LEVELS.items()}
VARIED = (
    *(
        drive(f"varied-{scene}", scene=scene, lead_brakes=True, speed_mps=speed, rate_hz=rate)
        for scene, speed, rate in (
            ("straight", 20.0, 20.0),
            ("bend", 15.0, 10.0),
            ("town", 12.0, 10.0),
            ("hill", 8.0, 5.0),
        )
    ),
    drive("varied-change", scene="town", change_lane="right", speed_mps=20.0),
)
"""Braking cars and a lane change at other speeds and rates, also where the road is not level."""
VARIED_LEADS = {level: replays(VARIED, noise, OBJECTS, f"{{}}, {level}") for level, noise in LEVELS.items()}
APPROACHES = tuple(
    drive(f"runner-{rate:g}-{speed:g}", scene=scene, path_truth=True, rate_hz=rate, speed_mps=speed, seconds=40 / speed)
    for rate, speed, scene in (
        (5.0, 10.0, "straight"),
        (5.0, 30.0, "bend"),
        (10.0, 5.0, "bend"),
        (10.0, 20.0, "straight"),
        (20.0, 10.0, "straight"),
        (20.0, 30.0, "bend"),
    )
)
"""People run across the road 38 m ahead of the start; the car arrives half a second after they cross the middle."""
CROSSED = tuple(
    drive(f"crossed-{speed:g}", scene="straight", crossing_cars=True, speed_mps=speed, seconds=4.2)
    for speed in (5.0, 12.0)
)
APPROACHING = replays((*APPROACHES, *CROSSED), MODEST, OBJECTS)
COURSE_OBSTACLE = (
    Scenario(
        "course obstacle", CoursePair(f"{DATA}/course_stereo"), settings=course.SETTINGS, template=course.TEMPLATE
    ),
)
ALONE_LEADS = replays(
    (
        drive(f"alone-{scene}", scene=scene, lead_brakes=True, seconds=5.0, pitch_std_deg=0.2, **ONE_CAMERA)
        for scene in ("straight", "bend")
    ),
    TAGS,
    OBJECTS,
    "one camera, {}",
)
ALONE_TOWN = Scenario("one camera, town", of_town("alone-town", path_truth=True, **ONE_CAMERA), TAGS, OBJECTS)
ALONE = (*ALONE_LEADS, ALONE_TOWN)
STANDING = {
    name: (Scenario(f"one camera, {name}", of, TAGS, MOTION),)
    for name, of in (
        ("stop", drive("alone-stop", scene="straight", lead_brakes=True, seconds=7.0, **SMALL, **ONE_CAMERA)),
        ("jam", drive("alone-jam", scene="town", stop_and_go=True, seconds=20.0, **SMALL, **ONE_CAMERA)),
        (
            "standing minute",
            drive("alone-static", 0.5, scene="town", static=True, rate_hz=5.0, seconds=60.0, **SMALL, **ONE_CAMERA),
        ),
    )
}
