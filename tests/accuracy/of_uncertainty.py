"""Values of the uncertainty figures: the report's consistency table over several replays."""

from functools import cache

from roadperc_stream.eval.consistency import Consistency, added, consistency_of_run
from roadperc_stream.eval.runs import open_run
from tests.accuracy.values import Measured, Value, nothing, percent

QUANTITIES = {
    "lane offset": 2,
    "lane heading": 2,
    "step": 2,
    "turn": 2,
    "distance": 4,
    "closing speed": 4,
    "time to impact": 4,
}
"""The maximum share in percent beyond three standard deviations."""
COLUMNS = {
    "lane offset": ("lane_left_offset_m", "lane_right_offset_m"),
    "lane heading": ("lane_heading_deg",),
    "step": ("step_m",),
    "turn": ("turn_deg",),
    "distance": ("distance_m",),
    "closing speed": ("closing_speed_mps",),
    "time to impact": ("time_to_impact_s",),
}


@cache
def of_replay(path):
    """The consistency of one replay."""
    return consistency_of_run(open_run(path, path.name))


def shares(quantity, scenarios, beyond_percent, results):
    """Shares within one and two standard deviations and beyond three, with NEES, pooled over replays."""
    total = added(of_replay(replay.path) for replay in results.of(scenarios))
    found = sum((total.get(name, Consistency()) for name in COLUMNS[quantity]), Consistency())
    if not found.values:
        return nothing("no standard deviation in the tables" if found.errors else "no truth")
    within_1, within_2, beyond_3 = found.within(1), found.within(2), 1 - found.within(3)
    interval = found.nees_interval
    nees = f"NEES {found.nees:.3g}" + (f", {interval[0]:.3g} to {interval[1]:.3g}" if interval else "")
    met = 0.5 <= within_1 <= 0.85 and within_2 >= 0.9 and 100 * beyond_3 <= beyond_percent
    text = f"{100 * within_1:.1f} / {100 * within_2:.1f} / {100 * beyond_3:.1f} % ({nees})"
    return Measured(text, percent(found.values / found.errors), met)


def steps_beyond(replays):
    """Share of the steps beyond three standard deviations, in percent."""
    found = sum((added([of_replay(replay.path)]).get("step_m", Consistency()) for replay in replays), Consistency())
    return Value(100 * (1 - found.within(3)) if found.values else None, detail=f"{found.values} steps")
