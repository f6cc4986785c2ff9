"""The list of figures, each with its scenarios and its required value."""

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

from tests.accuracy import scenarios as of
from tests.accuracy import values
from tests.accuracy.bounds import Bound, Measured, at_least, at_most, nothing
from tests.accuracy.scenarios import Scenario

REPORTED = Bound(None, "%")
"""A figure without a required value."""
AT_10_M = partial(values.gross, place="ahead_m")
P95 = {"share": 0.95}
DIFFERS, MUCH_USED = 2.0, 0.5
"""Scenes are shown one by one if one has more than this factor of another one's value, and of the limit."""


@dataclass(frozen=True)
class Figure:
    """A line of the table: a value of one or several groups of scenarios, with a bound or the text of a requirement."""

    section: str
    name: str
    bound: Bound | str
    groups: tuple[tuple[Scenario, ...], ...]
    value: Callable

    @property
    def required(self):
        """The text of the required value."""
        return self.bound if isinstance(self.bound, str) else self.bound.text

    @property
    def scenarios(self):
        """The scenarios of all groups."""
        return sum(self.groups, ())

    def measured(self, results):
        """The measured value, or the reason if there is no replay."""
        try:
            found = self.value(*(results.of(group) for group in self.groups))
        except LookupError as absent:
            return nothing(str(absent))
        return found if isinstance(found, Measured) else self.bound.judge(found)

    def by_scene(self, results):
        """The figures of single scenes with their values; none if all keep the limit well or hardly differ."""
        of_scene = defaultdict(list)
        for scenario in self.groups[0]:
            of_scene[scenario.scene].append(scenario)
        if len(self.groups) > 1 or len(of_scene) < 2:
            return []
        case, _, name = self.name.rpartition(": ")
        titles = {scene: f"{f'{case}, ' * bool(case)}{scene}: {name}" for scene in of_scene}
        figures = [replace(self, name=titles[scene], groups=(tuple(own),)) for scene, own in of_scene.items()]
        lines = [(figure, figure.measured(results)) for figure in figures]
        used = [measured.used for _, measured in lines if measured.used is not None]
        differ = used and max(used) > MUCH_USED and max(used) > DIFFERS * min(used)
        return lines if differ else []


def lines(section, *groups):
    """A function that returns a figure of these scenarios."""
    return lambda name, bound, value, **options: Figure(section, name, bound, groups, partial(value, **options))


def of_changes():
    """Lane changes: left, back, right and broken off, over dashed lines."""
    line = lines("Changes of lane", of.CHANGED)
    yield line("new lane measured and correct within 0.3 s of the crossing", at_least(100), values.handed)
    yield line("`lane_changes` counts every change", at_least(100), values.counted)
    turns = lines("Changes of lane", of.TURNED)
    yield turns("turns: `lane_changes` counts no change", at_least(100), values.counted)
    yield line("both measured, but wrong sides or not 2 to 6 m wide", at_most(0), values.implausible)
    yield from off_by_more("measured, ", line)
    yield line("offset at the car, median", at_most(2, "cm"), values.offset_error)
    yield line("offset at the car, 95 %", at_most(6, "cm"), values.offset_error, **P95)


def off_by_more(prefix, line):
    """Requirements on measured boundaries at any noise."""
    yield line(f"{prefix}off by more than 0.3 m at the car", at_most(1), values.gross)
    yield line(f"{prefix}off by more than 0.3 m 10 m ahead", at_most(1), AT_10_M)


COVERED = {0: REPORTED, 5: REPORTED, 10: at_least(90), 20: at_least(60), 40: at_least(25)}
PRECISE = {5: (2, 6), 10: (4, 15)}


def of_noise():
    """The same scenes at five noise levels, and inputs that are hard in other ways."""
    for level, scenarios in of.BY_TAG_NOISE.items():
        line, prefix = lines("Lanes and noise", scenarios), f"tag noise {level} %: "
        yield from off_by_more(f"{prefix}measured, ", line)
        yield line(f"{prefix}boundaries measured", COVERED[level], values.covered)
        median_cm, p95_cm = PRECISE.get(level, (None, None))
        yield line(f"{prefix}offset at the car, median", at_most(median_cm, "cm"), values.offset_error)
        yield line(f"{prefix}offset at the car, 95 %", at_most(p95_cm, "cm"), values.offset_error, **P95)
    kinds = {f"tags as JPEG {quality}: ": scenarios for quality, scenarios in of.BY_JPEG.items()}
    for prefix, scenarios in (kinds | {"depth noise 30 %: ": of.WITHOUT_DEPTH, "2 Hz: ": of.AT_TWO_HZ}).items():
        line = lines("Lanes and noise", scenarios)
        yield from off_by_more(f"{prefix}measured, ", line)
        yield line(f"{prefix}boundaries measured", REPORTED, values.covered)
        yield line(f"{prefix}absent without a reason", at_most(0), values.silent)
    line, prefix = lines("Lanes and noise", of.BEHIND_BONNET), "bonnet over 40 % of the rows: "
    yield line(f"{prefix}boundaries measured", at_least(90), values.covered)
    yield line(f"{prefix}off by more than 0.3 m at the car", REPORTED, values.gross)
    yield line(f"{prefix}off by more than 0.3 m 10 m ahead", at_most(1), AT_10_M)
    name = "stills with an unknown pitch of -6 to 6°: points within 20 px (TuSimple)"
    yield lines("Lanes and noise", of.ONE_BY_ONE)(name, at_least(0.93, ""), values.points_right)
    name = "course frame 1: left boundary off its measured line"
    yield lines("Lanes and noise", of.COURSE_FRAMES)(name, at_most(10, "cm"), values.off_own_line)


def of_surface():
    """The automatically chosen surface model compared with both models."""
    for road in of.ROADS:
        line = lines("Surface", *(of.BY_MODEL[road, model] for model in of.MODELS))
        for name, column in (
            ("road height 5 to 40 m ahead", "surface_height_error_m"),
            ("left boundary 10 m ahead", "lane_left_error_m"),
        ):
            title = f"{road}: {name}, median, plane / spline / auto"
            yield line(title, "auto ≤ 1.1 times the better one", values.by_model, column=column)


def of_motion():
    """One camera at a known height, on real images; turns at 2 Hz; images whose brightness changes."""
    for way, scenarios in of.KITTI_WAYS.items():
        line = lines("One camera, KITTI", scenarios)
        yield line(f"{way}: step, median error", at_most(2), values.step_error)
        yield line(f"{way}: length of the path", at_most(2), values.length_error)
        yield line(f"{way}: steps with scale", at_least(95), values.with_scale)
        yield line(f"{way}: steps beyond 3 deviations", at_most(4), values.steps_beyond)
    line = lines("One camera, turn", of.ALONE_TURN)
    yield line("step, median error", REPORTED, values.step_error)
    yield line("steps with scale", REPORTED, values.with_scale)
    yield line("steps beyond 3 deviations", at_most(4), values.steps_beyond)
    name = "level road, unknown pitch of -3 and 3°: height of the last pose, share of the path"
    yield lines("One camera, pose", of.TILTED)(name, at_most(1), values.height_error)
    line = lines("Turn at 2 Hz", *of.AT_WIDE_BASELINES)
    yield line("frames lost whose step `orb` gives within 10 %", at_most(0, "frames"), values.lost_where_others_track)
    yield line("step, median error, orb / klt", "klt ≤ 1.1 times orb", values.as_exact)
    for kind, scenarios in of.EXPOSURES.items():
        line = lines("Exposure", scenarios)
        if kind != "blackouts":
            yield line(f"{kind}: frames lost", at_most(0), values.lost)
        yield line(f"{kind}: last pose", at_most(1), values.end_error)


def of_standing():
    """A camera alone that slows down and stands."""
    for case, scenarios in of.STANDING.items():
        line = lines("One camera, standing", scenarios)
        yield line(f"{case}: largest drift while standing", at_most(10, "cm"), values.standing_drift)
        title = f"{case}: steps that need more than {values.MOST_MPS2} m/s²"
        yield line(title, at_most(0, "frames"), values.impossible_steps)
        yield line(f"{case}: steps beyond 3 deviations", at_most(4), values.steps_beyond)
        if case != "standing minute":
            yield line(f"{case}: steps with scale", REPORTED, values.with_scale)
            yield line(f"{case}: length of the path", REPORTED, values.length_error)


DISTANCES = ((0, 10), (10, 20), (20, 40), (40, 80))
OFF_BY_A_METRE = {"1+2 %": (1, 3, 4, 5), "2+5 %": (1, 5, 12, 15)}


def off_by_a_metre(line, prefix, limits):
    """Kept detections with a distance error above 1 m, by true distance."""
    for (nearest_m, farthest_m), limit in zip(DISTANCES, limits, strict=True):
        name = f"{prefix}off by over 1 m, {nearest_m} to {farthest_m} m"
        yield line(name, at_most(limit), values.off_by_a_metre, nearest_m=nearest_m, farthest_m=farthest_m)


def of_distances():
    """Distances in the town, without segmentation, and of cars in rows, each partly hidden by the next one."""
    for level, limits in OFF_BY_A_METRE.items():
        yield from off_by_a_metre(lines("Distances, town", of.TOWNS[level]), f"noise {level}: ", limits)
    for level, limits in OFF_BY_A_METRE.items():
        line, doubled = lines("Distances, town", of.WHOLE_BOXES[level]), [2 * limit for limit in limits]
        yield from off_by_a_metre(line, f"boxes of whole objects, noise {level}: ", doubled)
    for name, scenarios in of.UNTAGGED.items():
        line = lines("Distances without tags", scenarios)
        yield line(f"{name}: within 1 m or 2 deviations", at_least(100), values.right_or_unsure)
        yield line(f"{name}: deviation below 15 %", at_least(66.6), values.sure)
    line = lines("Distances, parked rows", of.PARKED["seen"])
    yield from off_by_a_metre(line, "", (5, 5, 5, 5))
    both = lines("Distances, parked rows", of.PARKED["seen"], of.PARKED["whole"])
    yield both("30 % or more visible: deviation below 10 %", at_least(80), values.sure_though_hidden)
    yield both("people seen to less than half: off by over 1 m", at_most(5), values.hidden_people_off)
    yield from deviations(line, "", ("distance",))


def beyond(line, prefix, quantities):
    """Errors beyond three standard deviations, with the median deviation and the coverage."""
    for quantity in quantities:
        name = f"{prefix}{quantity} beyond 3 deviations"
        yield line(name, at_most(values.QUANTITIES[quantity][0]), values.beyond, quantity=quantity)


def of_other_depth():
    """Stereo or a lidar as the only depth."""
    for kind, scenarios in of.WITHOUT_DEPTH_CAMERA.items():
        yield from beyond(lines("Stereo or lidar alone", scenarios), f"{kind}: ", ("distance", "closing speed"))


def of_filter():
    """Detections kept and dropped."""
    for name, scenarios, precision, recall in (
        ("sample", of.STANDARD, 0.82, 0.995),
        ("town", of.TOWNS["1+2 %"], 0.93, 0.995),
        ("town, tag noise 10 %", of.NOISY_TOWNS[10], 0.9, 0.95),
        ("town, tag noise 20 %", of.NOISY_TOWNS[20], 0.9, 0.85),
    ):
        line = lines("Filter", scenarios)
        yield line(f"{name}: precision", at_least(precision, ""), values.precision)
        yield line(f"{name}: recall", at_least(recall, ""), values.recall)


def of_impact():
    """Time to impact, in frames with and without a true one; the course's obstacle with the course's settings."""
    cases = {"sample": of.STANDARD, "turn": of.TURNING, "lane that merges": of.MERGING}
    for level in of.TOWNS:
        cases |= {f"town, noise {level}": of.TOWNS[level], f"braking lead car, noise {level}": of.BRAKING[level]}
    for name, scenarios in (cases | {"crossing people and cars": of.APPROACHING}).items():
        title = f"{name}: below 1.5 s although the true time is above 2 s or absent"
        yield lines("Impact", scenarios)(title, at_most(0, "frames"), values.false_alarms)
    title = "5 to 30 m/s, 5 to 20 Hz, 0.5 to 3 s: frames with a value, from the third one on"
    line = lines("Impact", (*of.APPROACHING, *of.BRAKING["1+2 %"]))
    yield line(title, at_least(97), values.impact_known, first=2)
    line, prefix = lines("Impact", of.BRAKING["1+2 %"]), "braking lead car, 0.5 to 3 s: "
    yield line(f"{prefix}frames with a value", at_least(95), values.impact_known)
    yield line(f"{prefix}error, median", at_most(0.2, "s"), values.impact_error)
    yield line(f"{prefix}error, 95 %", at_most(0.5, "s"), values.impact_error, **P95)
    for level, scenarios in of.VARIED_LEADS.items():
        line, prefix = lines("Impact, varied drives", scenarios), f"noise {level}: "
        yield line(f"{prefix}frames with a value", at_least(95), values.impact_known)
        yield line(f"{prefix}error, median", at_most(0.2, "s"), values.impact_error)
        yield from beyond(line, prefix, ("time to impact",))
    line = lines("Obstacle by its picture, course", of.COURSE_OBSTACLE)
    yield line("place", at_most(0, "px"), values.obstacle_place_off)
    yield line("distance", at_most(1, "mm"), values.obstacle_off)


def deviations(line, prefix, quantities):
    """Errors within one and two standard deviations, and beyond three."""
    for quantity in quantities:
        required = f"50 to 85 / ≥ 90 / ≤ {values.QUANTITIES[quantity][0]} %"
        name = f"{prefix}{quantity}, within 1 and 2 deviations, beyond 3"
        yield line(name, required, values.deviations, quantity=quantity)


def of_uncertainty():
    """Deviations in the town and behind a braking car, and of lanes whose only depth are lidar points."""
    for level, towns in of.TOWNS.items():
        line = lines("Uncertainty", (*towns, *of.BRAKING[level]))
        yield from deviations(line, f"noise {level}: ", values.QUANTITIES)
    yield from deviations(lines("Uncertainty", of.SPARSE), "lidar alone: ", ("lane offset", "lane heading"))
    for case, scenarios in of.LANE_TOWNS.items():
        yield from beyond(lines("Lanes, town", scenarios), f"{case}: ", ("lane offset", "lane heading"))


def of_one_camera():
    """Distances, times to impact and their deviations without depth."""
    line = lines("One camera", of.ALONE)
    for nearest_m, farthest_m, limit in ((0, 10, 6), (10, 20, 8), (20, 30, 12), (30, 50, 20)):
        name = f"distance error, median, {nearest_m} to {farthest_m} m"
        yield line(name, at_most(limit), values.distance_error, nearest_m=nearest_m, farthest_m=farthest_m)
    leads, prefix = lines("One camera", of.ALONE_LEADS), "braking lead car, 0.5 to 3 s: "
    yield leads(f"{prefix}frames with a value", at_least(70), values.impact_known)
    yield leads(f"{prefix}error, median", at_most(0.4, "s"), values.impact_error)
    yield from deviations(line, "", ("distance", "closing speed", "time to impact"))


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
    line = lines("Sample", of.STANDARD)
    for name, column, factor, unit, median, p95 in STANDARD_TODAY:
        for share, limit in ((0.5, median), (0.95, p95)):
            title = f"{name}, {'median' if share == 0.5 else '95 %'}"
            yield line(title, at_most(limit, unit), values.error_quantile, column=column, factor=factor, share=share)


FIGURES = (
    *of_changes(),
    *of_noise(),
    *of_surface(),
    *of_motion(),
    *of_standing(),
    *of_distances(),
    *of_other_depth(),
    *of_filter(),
    *of_impact(),
    *of_uncertainty(),
    *of_one_camera(),
    *of_standard(),
)
