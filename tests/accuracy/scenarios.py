"""The scenes and recordings of the figures, and the options of their replays."""

import os
from dataclasses import dataclass

from tests import course
from tests.accuracy.drives import ROOT, Drive, Excerpt, Noise, drive
from tests.conftest import DEFAULT_DATA

CLEAN, MODEST, HEAVY = Noise(), Noise(0.02, 0.01), Noise(0.05, 0.02)
MOTION = "surface,odometry"
LANES = "surface,odometry,lanes"
OBJECTS = "surface,odometry,lanes,objects"
TAG_NOISES = {percent: Noise(percent / 100, 0.01) for percent in (0, 5, 10, 20, 40)}
JPEGS = {quality: Noise(jpeg_quality=quality) for quality in (95, 75)}
BLIND = Noise(0.02, 0.3)
MODELS = ("plane", "spline", "auto")
DATA = os.environ.get("ROADPERC_DATA", str(DEFAULT_DATA))


@dataclass(frozen=True)
class Scenario:
    """A drive under a kind of noise, or a recording (a log, a folder, or frames of one), replayed with some stages."""

    name: str
    source: Drive | Excerpt | str
    noise: Noise = CLEAN
    only: str = ""
    settings: tuple[str, ...] = ()
    template: str = ""


CHANGES = (
    drive("change-left-back", scene="bend", change_lane="left", change_back=True, seconds=11.0),
    drive("change-right", scene="town", change_lane="right", seconds=6.5),
    drive("change-broken-off", scene="straight", change_lane="left", change_broken_off=True, seconds=6.0),
)
SWEPT = (CHANGES[1], drive("bend", scene="bend", weave_m=0.5, seconds=4.0))
TWO_HZ = drive("two-hz", scene="bend", weave_m=0.5, rate_hz=2.0, seconds=15.0)
HILL = drive("hill", scene="hill", rate_hz=2.0, seconds=8.0)
TOWN = drive("town", 2.5, scene="town", path_truth=True, rate_hz=5.0, seconds=8.0)
MERGE = drive("merge", scene="bend", lane="merges", path_truth=True, seconds=8.0)
ROWS = {
    kind: drive(f"parked-{kind}", scene="town", parked_rows=True, whole_boxes=kind == "whole", rate_hz=5.0, seconds=6.0)
    for kind in ("seen", "whole")
}
WHOLE = drive("town-whole", 2.0, scene="town", path_truth=True, whole_boxes=True, rate_hz=5.0, seconds=8.0)
TURN = drive("turn", scene="town", turn="right", path_truth=True, seconds=6.0)
TURNS = tuple(drive(f"whole-turn-{side}", scene="town", turn=side, seconds=11.0) for side in ("left", "right"))
LIDARS = tuple(
    drive(f"lidar-{scene}", scene=scene, lidar=True, weave_m=0.5, seconds=4.0, without=("right", "depth"))
    for scene in ("bend", "town")
)
BONNETS = tuple(
    drive(name, scene="bend", bonnet=0.4, seconds=3.0, without=without)
    for name, without in (("bonnet", ("right",)), ("bonnet-alone", ("right", "depth")))
)
STILLS = tuple(
    drive(
        f"still-{pitch_deg}",
        scene=scene,
        rate_hz=0.2,
        seconds=20.0,
        fov_deg=55.0,
        mount=(1.5, 0.0, 1.4, 0.0, pitch_deg, 0.0),
        pitch_is_unknown=True,
        without=("right", "depth"),
    )
    for pitch_deg, scene in ((-6.0, "straight"), (-3.0, "bend"), (0.0, "straight"), (3.0, "bend"), (6.0, "straight"))
)
LEADS = tuple(drive(f"lead-{scene}", scene=scene, lead_brakes=True, seconds=5.0) for scene in ("straight", "bend"))
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
SAMPLE = str(ROOT / "logs" / "sample.mcap")
KITTI = f"{DATA}/kitti_odometry"
COURSE_STEREO = f"{DATA}/course_stereo"


def swept(prefix, noise):
    """The scenes of the noise comparison, with one kind of noise."""
    return tuple(Scenario(f"{prefix}, {of.name}", of, noise, LANES) for of in SWEPT)


CHANGED = tuple(Scenario(of.name, of, MODEST, LANES) for of in CHANGES)
BY_TAG_NOISE = {percent: swept(f"tags {percent} %", noise) for percent, noise in TAG_NOISES.items()}
BY_JPEG = {quality: swept(f"jpeg {quality}", noise) for quality, noise in JPEGS.items()}
WITHOUT_DEPTH = swept("depth 30 %", BLIND)
AT_TWO_HZ = (Scenario("2 Hz", TWO_HZ, MODEST, LANES),)
ROADS = {"hill": HILL, "bend": SWEPT[1], "sample": SAMPLE}
BY_MODEL = {
    (road, model): (
        Scenario(f"{road}, {model}", of, CLEAN if of == SAMPLE else MODEST, LANES, (f"surface.model={model}",)),
    )
    for road, of in ROADS.items()
    for model in MODELS
}
TOWNS = {
    level: (Scenario(f"town, {level}", TOWN, noise, OBJECTS),) for level, noise in (("1+2 %", MODEST), ("2+5 %", HEAVY))
}
NOISY_TOWNS = {
    percent: (Scenario(f"town, tags {percent} %", TOWN, TAG_NOISES[percent], OBJECTS),) for percent in (10, 20)
}
PARKED = {kind: (Scenario(f"parked rows, {kind}", of, MODEST, OBJECTS),) for kind, of in ROWS.items()}
MERGING = (Scenario("merge", MERGE, MODEST, OBJECTS),)
WHOLE_BOXES = {
    level: (Scenario(f"town, whole boxes, {level}", WHOLE, noise, OBJECTS),)
    for level, noise in (("1+2 %", MODEST), ("2+5 %", HEAVY))
}
TURNING = (Scenario("turn", TURN, MODEST, OBJECTS),)
TURNED = tuple(Scenario(of.name, of, MODEST, LANES) for of in TURNS)
SPARSE = tuple(Scenario(of.name, of, Noise(0.02), LANES) for of in LIDARS)
BEHIND_BONNET = tuple(
    Scenario(of.name, of, noise, LANES) for of, noise in zip(BONNETS, (MODEST, Noise(0.02)), strict=True)
)
ONE_BY_ONE = tuple(Scenario(of.name, of, Noise(0.02), LANES) for of in STILLS)
BRAKING = {
    level: tuple(Scenario(f"{of.name}, {level}", of, noise, OBJECTS) for of in LEADS)
    for level, noise in (("1+2 %", MODEST), ("2+5 %", HEAVY))
}
UNTAGGED = {
    "depth": (
        Scenario(
            "no tags, depth",
            drive("untagged", scene="town", rate_hz=1.25, seconds=8.0, without=("right", "segmentation")),
            Noise(depth=0.01),
            "surface,objects",
        ),
    ),
    "lidar": (
        Scenario(
            "no tags, lidar",
            drive(
                "untagged-lidar",
                scene="town",
                rate_hz=1.25,
                seconds=8.0,
                lidar=True,
                without=("right", "segmentation", "depth"),
            ),
            CLEAN,
            "surface,objects",
        ),
    ),
    "KITTI": (Scenario("kitti object", f"{DATA}/kitti_object", only="surface,objects"),),
}
APPROACHING = tuple(Scenario(of.name, of, MODEST, OBJECTS) for of in (*APPROACHES, *CROSSED))
ONE_CAMERA = {"without": ("depth", "right"), "fov_deg": 70.0}
ALONE_LEADS = tuple(
    Scenario(f"one camera, {of.name}", of, Noise(0.02), OBJECTS)
    for of in (
        drive(f"alone-{scene}", scene=scene, lead_brakes=True, seconds=5.0, pitch_std_deg=0.2, **ONE_CAMERA)
        for scene in ("straight", "bend")
    )
)
ALONE_TOWN = Scenario(
    "one camera, town",
    drive("alone-town", scene="town", path_truth=True, rate_hz=5.0, seconds=8.0, **ONE_CAMERA),
    Noise(0.02),
    OBJECTS,
)
ALONE = (*ALONE_LEADS, ALONE_TOWN)
STANDARD = (Scenario("sample", SAMPLE),)
COURSE_FRAMES = (Scenario("course frames", f"{DATA}/course_frames"),)
COURSE_OBSTACLE = (Scenario("course obstacle", COURSE_STEREO, settings=course.SETTINGS, template=course.TEMPLATE),)
SMALL = {"scene": "town", "width": 320, "height": 240, "seconds": 3.0}
EXPOSURES = {
    kind: (
        Scenario(
            f"exposure {kind}", drive(f"exposure-{kind}", exposure=kind, rate_hz=rate_hz, **SMALL), MODEST, MOTION
        ),
    )
    for kind, rate_hz in (("steps", 10.0), ("frames", 10.0), ("blackouts", 20.0))
}
KITTI_WAYS = {
    name: (Scenario(f"kitti, {name}", KITTI if step == 1 else Excerpt(KITTI, step), only=MOTION),)
    for name, step in (("forwards", 1), ("backwards", -1), ("every second frame", 2))
}
ALONE_TURN = (
    Scenario(
        "one camera, turn",
        drive(
            "alone-turn", scene="town", turn="left", width=320, height=240, seconds=12.0, speed_mps=6.0, **ONE_CAMERA
        ),
        Noise(0.02),
        MOTION,
    ),
)
WIDE_TURNS = tuple(
    drive(f"wide-turn-{side}", scene="town", turn=side, rate_hz=2.0, seconds=12.0, speed_mps=5.0)
    for side in ("left", "right")
)
AT_WIDE_BASELINES = {
    features: tuple(
        Scenario(f"{of.name}, {features}", of, CLEAN, MOTION, (f"odometry.features={features}",)) for of in WIDE_TURNS
    )
    for features in ("klt", "orb")
}
TILTED = tuple(
    Scenario(of.name, of, Noise(0.02), MOTION)
    for of in (
        drive(
            f"tilted-{scene}",
            scene=scene,
            width=320,
            height=240,
            seconds=6.0,
            mount=(1.5, 0.0, 1.4, 0.0, pitch_deg, 0.0),
            pitch_is_unknown=True,
            **ONE_CAMERA,
        )
        for scene, pitch_deg in (("straight", -3.0), ("bend", 3.0))
    )
)
