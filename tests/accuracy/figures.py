"""The list of figures, each with its scenarios and its required value."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from tests.accuracy import of_lanes, of_motion, of_objects, of_uncertainty
from tests.accuracy.running import Results
from tests.accuracy.scenarios import (
    ALONE,
    ALONE_LEADS,
    ALONE_TURN,
    APPROACHING,
    AT_TWO_HZ,
    AT_WIDE_BASELINES,
    BEHIND_BONNET,
    BRAKING,
    BY_JPEG,
    BY_MODEL,
    BY_TAG_NOISE,
    CHANGED,
    COURSE_FRAMES,
    COURSE_OBSTACLE,
    EXPOSURES,
    KITTI_WAYS,
    MERGING,
    MODELS,
    NOISY_TOWNS,
    ONE_BY_ONE,
    PARKED,
    ROADS,
    SPARSE,
    STANDARD,
    TILTED,
    TOWNS,
    TURNED,
    TURNING,
    UNTAGGED,
    WHOLE_BOXES,
    WITHOUT_DEPTH,
    Scenario,
)
from tests.accuracy.values import Bound, Measured, at_least, at_most, judged, nothing

Measure = Callable[[Results], Measured]
REPORTED = None
"""A figure without a required value."""


@dataclass(frozen=True)
class Figure:
    """A line of the table: the text of the required value, and a function that measures and judges."""

    section: str
    name: str
    required: str
    scenarios: tuple[Scenario, ...]
    measure: Measure

    def measured(self, results):
        """The measured value, or the reason if a replay or a column is missing."""
        try:
            return self.measure(results)
        except LookupError as absent:
            return nothing(str(absent))


def bounded(section, name, bound: Bound | None, scenarios, value):
    """A figure whose value is a function of the replays and has a bound."""

    def measure(results):
        return judged(bound, value(results.of(scenarios)))

    return Figure(section, name, bound.text if bound else "", scenarios, measure)


def of_changes():
    """Lane changes: left, back, right and broken off, over dashed lines."""
    line = partial(bounded, "Changes of lane", scenarios=CHANGED)
    return (
        line("new lane measured and correct within 0.3 s of the crossing", at_least(100, "%"), value=of_lanes.handed),
        line("`lane_changes` counts every change", at_least(100, "%"), value=of_lanes.counted),
        bounded(
            "Changes of lane", "turns: `lane_changes` counts no change", at_least(100, "%"), TURNED, of_lanes.counted
        ),
        line("both measured, but wrong sides or not 2 to 6 m wide", at_most(0, "%"), value=of_lanes.implausible),
        *off_by_more("", line),
        line("offset at the car, median", at_most(2, "cm"), value=of_lanes.offset_error),
        line("offset at the car, 95 %", at_most(6, "cm"), value=partial(of_lanes.offset_error, share=0.95)),
    )


def off_by_more(prefix, line):
    """Requirements on measured boundaries at any noise."""
    return (
        line(f"{prefix}measured, off by more than 0.3 m at the car", at_most(1, "%"), value=of_lanes.gross),
        line(
            f"{prefix}measured, off by more than 0.3 m 10 m ahead",
            at_most(1, "%"),
            value=partial(of_lanes.gross, place="ahead_m"),
        ),
    )


COVERED = {0: REPORTED, 5: REPORTED, 10: at_least(90, "%"), 20: at_least(60, "%"), 40: at_least(25, "%")}
PRECISE = {5: (2, 6), 10: (4, 15)}


def of_tag_noise():
    """The same scenes at five noise levels."""
    for percent, scenarios in BY_TAG_NOISE.items():
        line, prefix = partial(bounded, "Lanes and noise", scenarios=scenarios), f"tag noise {percent} %: "
        yield from off_by_more(prefix, line)
        yield line(f"{prefix}boundaries measured", COVERED[percent], value=of_lanes.covered)
        median_cm, p95_cm = PRECISE.get(percent, (None, None))
        yield line(f"{prefix}offset at the car, median", at_most(median_cm, "cm"), value=of_lanes.offset_error)
        yield line(
            f"{prefix}offset at the car, 95 %", at_most(p95_cm, "cm"), value=partial(of_lanes.offset_error, share=0.95)
        )


def of_hard_inputs():
    """Tags as JPEG, noisy depth, few frames per second."""
    kinds = {f"tags as JPEG {quality}: ": scenarios for quality, scenarios in BY_JPEG.items()}
    for prefix, scenarios in (kinds | {"depth noise 30 %: ": WITHOUT_DEPTH, "2 Hz: ": AT_TWO_HZ}).items():
        line = partial(bounded, "Lanes and noise", scenarios=scenarios)
        yield from off_by_more(prefix, line)
        yield line(f"{prefix}boundaries measured", REPORTED, value=of_lanes.covered)
        yield line(f"{prefix}absent without a reason", at_most(0, "%"), value=of_lanes.silent)
    line = partial(bounded, "Lanes and noise", scenarios=BEHIND_BONNET)
    prefix = "bonnet over 40 % of the rows: "
    yield line(f"{prefix}boundaries measured", at_least(90, "%"), value=of_lanes.covered)
    yield line(f"{prefix}off by more than 0.3 m at the car", REPORTED, value=of_lanes.gross)
    value = partial(of_lanes.gross, place="ahead_m")
    yield line(f"{prefix}off by more than 0.3 m 10 m ahead", at_most(1, "%"), value=value)
    name = "stills with an unknown pitch of -6 to 6°: points within 20 px (TuSimple)"
    yield bounded("Lanes and noise", name, at_least(0.93, ""), ONE_BY_ONE, of_lanes.points_right)
    name = "course frame 1: left boundary off its measured line"
    yield bounded("Lanes and noise", name, at_most(10, "cm"), COURSE_FRAMES, of_lanes.off_own_line)


def of_surface():
    """The automatically chosen surface model compared with both models."""
    for road in ROADS:
        for name, column in (
            ("road height 5 to 40 m ahead", "surface_height_error_m"),
            ("left boundary 10 m ahead", "lane_left_error_m"),
        ):
            measure = partial(of_motion.by_model, road, column)
            scenarios = tuple(scenario for model in MODELS for scenario in BY_MODEL[road, model])
            title = f"{road}: {name}, median, plane / spline / auto"
            yield Figure("Surface", title, "auto ≤ 1.1 times the better one", scenarios, measure)


def of_odometry():
    """One camera at a known height, on real images."""
    for way, scenarios in KITTI_WAYS.items():
        line = partial(bounded, "One camera, KITTI", scenarios=scenarios)
        yield line(f"{way}: step, median error", at_most(2, "%"), value=of_motion.step_error)
        yield line(f"{way}: length of the path", at_most(2, "%"), value=of_motion.length_error)
        yield line(f"{way}: steps with scale", at_least(95, "%"), value=of_motion.with_scale)
        yield line(f"{way}: steps beyond 3 deviations", at_most(4, "%"), value=of_uncertainty.steps_beyond)
    line = partial(bounded, "One camera, turn", scenarios=ALONE_TURN)
    yield line("step, median error", REPORTED, value=of_motion.step_error)
    yield line("steps with scale", REPORTED, value=of_motion.with_scale)
    yield line("steps beyond 3 deviations", at_most(4, "%"), value=of_uncertainty.steps_beyond)
    name = "level road, unknown pitch of -3 and 3°: height of the last pose, share of the path"
    yield bounded("One camera, pose", name, at_most(1, "%"), TILTED, of_motion.height_error)


def of_wide_baselines():
    """Turns at 2 Hz, with the default features and with ORB alone."""
    scenarios = AT_WIDE_BASELINES["klt"], AT_WIDE_BASELINES["orb"]
    for name, required, measure in (
        ("frames lost whose step `orb` gives within 10 %", "≤ 0 frames", of_motion.lost_where_others_track),
        ("step, median error, klt / orb", "klt ≤ 1.1 times orb", of_motion.as_exact),
    ):
        yield Figure("Turn at 2 Hz", name, required, sum(scenarios, ()), partial(measure, *scenarios))


def of_exposure():
    """Images whose brightness changes, and black ones, with depth."""
    line = partial(bounded, "Exposure")
    for kind, scenarios in EXPOSURES.items():
        if kind != "blackouts":
            yield line(f"{kind}: frames lost", at_most(0, "%"), scenarios, of_motion.lost)
        yield line(f"{kind}: last pose", at_most(1, "%"), scenarios, of_motion.end_error)


DISTANCES = ((0, 10), (10, 20), (20, 40), (40, 80))
OFF_BY_A_METRE = {"1+2 %": (1, 3, 4, 5), "2+5 %": (1, 5, 12, 15)}


def of_distances():
    """Kept detections with a distance error above 1 m, by true distance."""
    cases = [(f"noise {level}: ", TOWNS[level], limits) for level, limits in OFF_BY_A_METRE.items()]
    for level, limits in OFF_BY_A_METRE.items():
        doubled = tuple(2 * limit for limit in limits)
        cases.append((f"boxes of whole objects, noise {level}: ", WHOLE_BOXES[level], doubled))
    for prefix, scenarios, limits in cases:
        for (nearest_m, farthest_m), limit in zip(DISTANCES, limits, strict=True):
            value = partial(of_objects.off_by_a_metre, nearest_m=nearest_m, farthest_m=farthest_m)
            name = f"{prefix}off by over 1 m, {nearest_m} to {farthest_m} m"
            yield bounded("Distances, town", name, at_most(limit, "%"), scenarios, value)


def of_untagged():
    """Distances by depth or lidar alone, without segmentation."""
    for name, scenarios in UNTAGGED.items():
        line = partial(bounded, "Distances without tags", scenarios=scenarios)
        title = f"{name}: within 1 m or 2 deviations"
        yield line(title, at_least(100, "%"), value=of_objects.right_or_unsure)
        yield line(f"{name}: deviation below 15 %", at_least(66.6, "%"), value=of_objects.sure)


def of_hidden():
    """Cars parked in rows, each partly hidden by the next one."""
    line = partial(bounded, "Distances, parked rows", scenarios=PARKED["seen"])
    for nearest_m, farthest_m in DISTANCES:
        value = partial(of_objects.off_by_a_metre, nearest_m=nearest_m, farthest_m=farthest_m)
        yield line(f"off by over 1 m, {nearest_m} to {farthest_m} m", at_most(5, "%"), value=value)
    scenarios = (*PARKED["seen"], *PARKED["whole"])
    name, value = "30 % or more visible: deviation below 10 %", of_objects.sure_though_hidden
    yield bounded("Distances, parked rows", name, at_least(80, "%"), scenarios, value)
    name, value = "people seen to less than half: off by over 1 m", of_objects.hidden_people_off
    yield bounded("Distances, parked rows", name, at_most(5, "%"), scenarios, value)
    measure = partial(of_uncertainty.shares, "distance", PARKED["seen"], of_uncertainty.QUANTITIES["distance"])
    name = "distance, within 1 and 2 deviations, beyond 3"
    yield Figure("Distances, parked rows", name, "50 to 85 / ≥ 90 / ≤ 4 %", PARKED["seen"], measure)


def of_filter():
    """Detections kept and dropped."""
    for name, scenarios, precision in (("sample", STANDARD, 0.82), ("town", TOWNS["1+2 %"], 0.93)):
        line = partial(bounded, "Filter", scenarios=scenarios)
        yield line(f"{name}: precision", at_least(precision, ""), value=of_objects.precision)
        yield line(f"{name}: recall", at_least(0.995, ""), value=of_objects.recall)
    for percent, recall in ((10, 0.95), (20, 0.85)):
        line = partial(bounded, "Filter", scenarios=NOISY_TOWNS[percent])
        yield line(f"town, tag noise {percent} %: precision", at_least(0.9, ""), value=of_objects.precision)
        yield line(f"town, tag noise {percent} %: recall", at_least(recall, ""), value=of_objects.recall)


IMPACTS = {"town": TOWNS, "braking lead car": BRAKING}


def of_obstacle():
    """The course's obstacle with the course's settings."""
    line = partial(bounded, "Obstacle by its picture, course", scenarios=COURSE_OBSTACLE)
    yield line("place", at_most(0, "px"), value=of_objects.obstacle_place_off)
    yield line("distance", at_most(1, "mm"), value=of_objects.obstacle_off)


def of_impact():
    """Time to impact, in frames with and without a true one."""
    noisy = {f"{name}, noise {level}": by[level] for level in TOWNS for name, by in IMPACTS.items()}
    crossing = "crossing people and cars"
    cases = {"sample": STANDARD, "turn": TURNING, "lane that merges": MERGING, **noisy, crossing: APPROACHING}
    for name, scenarios in cases.items():
        title = f"{name}: below 1.5 s although the true time is above 2 s or absent"
        yield bounded("Impact", title, at_most(0, "frames"), scenarios, of_objects.false_alarms)
    title = "5 to 30 m/s, 5 to 20 Hz, 0.5 to 3 s: frames with a value, from the third one on"
    value = partial(of_objects.impact_known, first=2)
    yield bounded("Impact", title, at_least(97, "%"), (*APPROACHING, *BRAKING["1+2 %"]), value)
    line = partial(bounded, "Impact", scenarios=BRAKING["1+2 %"])
    yield line("braking lead car, 0.5 to 3 s: frames with a value", at_least(95, "%"), value=of_objects.impact_known)
    yield line("braking lead car, 0.5 to 3 s: error, median", at_most(0.2, "s"), value=of_objects.impact_error)
    yield line(
        "braking lead car, 0.5 to 3 s: error, 95 %",
        at_most(0.5, "s"),
        value=partial(of_objects.impact_error, share=0.95),
    )


def of_deviations():
    """Within one and two standard deviations, and beyond three."""
    for level, towns in TOWNS.items():
        for quantity, beyond in of_uncertainty.QUANTITIES.items():
            scenarios = (*towns, *BRAKING[level])
            measure = partial(of_uncertainty.shares, quantity, scenarios, beyond)
            required = f"50 to 85 / ≥ 90 / ≤ {beyond} %"
            yield Figure(
                "Uncertainty",
                f"noise {level}: {quantity}, within 1 and 2 deviations, beyond 3",
                required,
                scenarios,
                measure,
            )


def of_sparse_depth():
    """Deviations of the lanes on a road whose only depth are lidar points."""
    for quantity in ("lane offset", "lane heading"):
        measure = partial(of_uncertainty.shares, quantity, SPARSE, of_uncertainty.QUANTITIES[quantity])
        name = f"lidar alone: {quantity}, within 1 and 2 deviations, beyond 3"
        yield Figure("Uncertainty", name, "50 to 85 / ≥ 90 / ≤ 2 %", SPARSE, measure)


def of_one_camera():
    """Distances, times to impact and their deviations without depth."""
    for (nearest_m, farthest_m), limit in zip(((0, 10), (10, 20), (20, 30), (30, 50)), (6, 8, 12, 20), strict=True):
        value = partial(of_objects.distance_error, nearest_m=nearest_m, farthest_m=farthest_m)
        name = f"distance error, median, {nearest_m} to {farthest_m} m"
        yield bounded("One camera", name, at_most(limit, "%"), ALONE, value)
    line = partial(bounded, "One camera", scenarios=ALONE_LEADS)
    yield line("braking lead car, 0.5 to 3 s: frames with a value", at_least(70, "%"), value=of_objects.impact_known)
    yield line("braking lead car, 0.5 to 3 s: error, median", at_most(0.4, "s"), value=of_objects.impact_error)
    for quantity in ("distance", "closing speed", "time to impact"):
        yield Figure(
            "One camera",
            f"{quantity}, within 1 and 2 deviations, beyond 3",
            f"50 to 85 / ≥ 90 / ≤ {of_uncertainty.QUANTITIES[quantity]} %",
            ALONE,
            partial(of_uncertainty.shares, quantity, ALONE, of_uncertainty.QUANTITIES[quantity]),
        )


STANDARD_TODAY = (
    ("lane left 10 m ahead", "lane_left_error_m", 100, "cm", 0.62, 1.37),
    ("lane right 10 m ahead", "lane_right_error_m", 100, "cm", 0.42, 0.85),
    ("road height 5 to 40 m ahead", "surface_height_error_m", 100, "cm", 13.04, 15.31),
    ("step", "step_error_m", 1000, "mm", 1.34, 3.98),
    ("turn", "turn_error_deg", 1, "°", 0.0077, 0.0151),
    ("stereo disparity", "stereo_epe_px", 1, "px", 0.404, 0.471),
)
"""Values of version 0.1.0 on ``logs/sample.mcap``, median and 95 %: they must not get worse."""


def of_standard():
    """The drive of ``make demo``."""
    for name, column, factor, unit, median, p95 in STANDARD_TODAY:
        for share, limit in ((0.5, median), (0.95, p95)):
            value = partial(of_motion.error_quantile, column=column, factor=factor, share=share)
            title = f"{name}, {'median' if share == 0.5 else '95 %'}"
            yield bounded("Sample", title, at_most(limit, unit), STANDARD, value)


FIGURES = (
    *of_changes(),
    *of_tag_noise(),
    *of_hard_inputs(),
    *of_surface(),
    *of_odometry(),
    *of_wide_baselines(),
    *of_exposure(),
    *of_distances(),
    *of_untagged(),
    *of_hidden(),
    *of_filter(),
    *of_impact(),
    *of_obstacle(),
    *of_deviations(),
    *of_sparse_depth(),
    *of_one_camera(),
    *of_standard(),
)
