"""Consistency of the chain's standard deviations: errors against truth in units of their deviation.

The mean of the squares is the normalised estimation error squared (NEES; Bar-Shalom, Li and Kirubarajan, "Estimation
with Applications to Tracking and Navigation", 2001, section 5.4). It is 1 for a correct deviation and larger for an
overconfident one. Errors of neighbouring frames, and of one object, are correlated, so the book's chi-squared bounds do
not apply. The interval is that of a ratio of sums over blocks (Cochran, "Sampling Techniques", 1977, 6.3). A block is
an object, or as many frames as the errors' autocorrelation requires.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Final

import numpy as np
import polars as pl
from numpy.typing import NDArray

from roadperc_stream.geometry import Float

from ..compare.bootstrap import LEVEL, block_length
from ..dataset.reading import reading_files
from .sources import RUN, Frames

_FARTHEST: Final = 1e6
"""Largest absolute normalised error; larger ones are clipped, so that sums stay finite."""
_FEWEST_BLOCKS: Final = 8
"""Fewest blocks for an interval."""


@dataclass(frozen=True)
class Judged:
    """A quantity, its truth and its standard deviation: three columns of a table in the same unit.

    ``truth`` is empty if the quantity is an error already, as those by hindsight.
    """

    estimate: str
    truth: str
    std: str


FRAME_QUANTITIES: Final = (
    Judged("lane_left_offset_m", "lane_left_true_offset_m", "lane_left_offset_std_m"),
    Judged("lane_right_offset_m", "lane_right_true_offset_m", "lane_right_offset_std_m"),
    Judged("lane_heading_deg", "lane_true_heading_deg", "lane_heading_std_deg"),
    Judged("step_m", "true_step_m", "step_std_m"),
    Judged("turn_deg", "true_turn_deg", "turn_std_deg"),
    Judged("lane_left_hindsight_m", "", "lane_left_hindsight_std_m"),
    Judged("lane_right_hindsight_m", "", "lane_right_hindsight_std_m"),
    Judged("step_hindsight_m", "", "step_hindsight_std_m"),
)
"""Quantities of the table with one row per frame."""
OBJECT_QUANTITIES: Final = (
    Judged("distance_m", "true_distance_m", "distance_std_m"),
    Judged("closing_speed_mps", "true_closing_speed_mps", "closing_speed_std_mps"),
    Judged("time_to_impact_s", "true_time_to_impact_s", "time_to_impact_std_s"),
    Judged("object_distance_hindsight_m", "", "object_distance_hindsight_std_m"),
    Judged("closing_speed_hindsight_mps", "", "closing_speed_hindsight_std_mps"),
    Judged("time_to_impact_hindsight_s", "", "time_to_impact_hindsight_std_s"),
)
"""Quantities of the table with one row per detection; only kept detections are used."""
JUDGED: Final = (*FRAME_QUANTITIES, *OBJECT_QUANTITIES)


@dataclass(frozen=True)
class Consistency:
    """Sums over normalised errors, which can be added over tables.

    ``errors`` counts the values with known truth, ``values`` those that also have a standard deviation above zero.
    ``within_1`` to ``within_3`` count the values that are off by at most 1 to 3 deviations. S is the sum of squared
    normalised errors of a block, N its number of values. The other fields are sums of S, S², S N and N² over the
    ``blocks``.
    """

    errors: int = 0
    values: int = 0
    within_1: int = 0
    within_2: int = 0
    within_3: int = 0
    blocks: int = 0
    squares: float = 0.0
    s_s: float = 0.0
    s_n: float = 0.0
    n_n: float = 0.0

    def __add__(self, other: "Consistency") -> "Consistency":
        """The sums over both."""
        return Consistency(*(getattr(self, field.name) + getattr(other, field.name) for field in fields(self)))

    def within(self, sigmas: int) -> float:
        """Share of the values that are off by at most 1, 2 or 3 standard deviations."""
        counted = (self.within_1, self.within_2, self.within_3)
        return counted[sigmas - 1] / self.values

    @property
    def nees(self) -> float:
        """Mean of the squared normalised errors."""
        return self.squares / self.values

    @property
    def nees_interval(self) -> tuple[float, float] | None:
        """Interval of the mean at ``LEVEL``, from blocks; None if there are too few.

        The mean is positive and its distribution skewed, so the interval is symmetric in the logarithm.
        """
        if self.blocks < _FEWEST_BLOCKS or self.squares == 0:
            return None
        from scipy import special  # its import takes a quarter of a second

        mean = self.nees
        scatter = max(self.s_s - 2 * mean * self.s_n + mean**2 * self.n_n, 0.0)
        error = np.sqrt(scatter * self.blocks / (self.blocks - 1)) / self.values
        factor = float(np.exp(special.stdtrit(self.blocks - 1, (1 + LEVEL) / 2) * error / mean))
        return mean / factor, mean * factor


def consistency(normalised: Float, errors: int, blocks: NDArray[np.int64]) -> Consistency:
    """The sums over the finite ones of (N,) normalised errors.

    Args:
        normalised: (N,) errors in units of their deviation, NaN if unknown.
        errors: number of errors with known truth.
        blocks: (N,) block of each error, from 0.
    """
    known = np.isfinite(normalised)
    sizes, blocks = np.abs(normalised[known]), blocks[known]
    squares = np.bincount(blocks, sizes**2)
    numbers = np.bincount(blocks)
    within = {f"within_{sigmas}": int(np.count_nonzero(sizes <= sigmas)) for sigmas in (1, 2, 3)}
    return Consistency(
        errors=errors,
        values=len(sizes),
        **within,
        blocks=int(np.count_nonzero(numbers)),
        squares=float(squares.sum()),
        s_s=float(squares @ squares),
        s_n=float(squares @ numbers),
        n_n=float(numbers @ numbers),
    )


def consistency_of_frames(normalised: Float, errors: int) -> Consistency:
    """The same for errors in frame order, in blocks as long as the autocorrelation of the squares requires."""
    known = normalised[np.isfinite(normalised)]
    length = block_length(known**2) if len(known) else 1
    return consistency(known, errors, np.arange(len(known)) // length)


def consistency_by_run(frames: Frames) -> list[dict[str, Consistency]]:
    """Consistency of each quantity with known truth in each run, by name.

    Raises:
        TableError: a table cannot be read.
    """
    table = frames.beside(_columns(FRAME_QUANTITIES))
    found = [
        {judged.estimate: consistency_of_frames(*errors_of(own, judged)) for judged in FRAME_QUANTITIES}
        for own in table.partition_by(RUN, maintain_order=True)
    ]
    for (run,), own in kept_objects(frames).partition_by(RUN, as_dict=True).items():
        numbers = object_numbers(own)
        found[run] |= {judged.estimate: consistency(*errors_of(own, judged), numbers) for judged in OBJECT_QUANTITIES}
    return [{name: sums for name, sums in of_run.items() if sums.errors} for of_run in found]


def added(parts: Iterable[Mapping[str, Consistency]]) -> dict[str, Consistency]:
    """The sums over several runs."""
    total: dict[str, Consistency] = {}
    for part in parts:
        for name, sums in part.items():
            total[name] = total.get(name, Consistency()) + sums
    return total


def errors_of(table: pl.DataFrame, judged: Judged) -> tuple[Float, int]:
    """(N,) estimate minus truth in units of its deviation, NaN if unknown; and the number of known errors."""
    estimate, std = (table[name].to_numpy() for name in (judged.estimate, judged.std))
    truth = table[judged.truth].to_numpy() if judged.truth else 0.0
    with np.errstate(over="ignore", invalid="ignore"):  # tables may hold any number
        error = estimate - truth
        normalised = error / np.where(std > 0, std, np.nan)
    known = np.isfinite(error)
    return np.where(known, np.clip(normalised, -_FARTHEST, _FARTHEST), np.nan), int(np.count_nonzero(known))


def kept_objects(frames: Frames) -> pl.DataFrame:
    """The kept detections, with the number of their run, their track and the columns of ``OBJECT_QUANTITIES``.

    Raises:
        TableError: the data cannot be read.
    """
    source, columns = frames.source, _columns(OBJECT_QUANTITIES)
    if source.objects is None:
        return pl.DataFrame(schema={RUN: pl.Int64})
    values = pl.col("track_id").cast(pl.String), pl.col(columns).cast(pl.Float64)
    with reading_files(source.object_files):
        rows = source.objects.filter("kept").select(*source.keys, *values).collect()
    runs = frames.runs.select(source.keys).with_row_index("number")
    found = rows.join(runs, on=source.keys, maintain_order="left")
    return found.select(pl.col("number").alias(RUN), "track_id", *columns)


def object_numbers(table: pl.DataFrame) -> NDArray[np.int64]:
    """(N,) object number of each row, from 0; each row without a track is a separate object."""
    ranks = table["track_id"].rank("dense").to_numpy().astype(float)
    untracked = np.isnan(ranks)
    alone = table.height + np.cumsum(untracked)
    return np.where(untracked, alone, np.nan_to_num(ranks) - 1).astype(np.int64)


def _columns(judged: Sequence[Judged]) -> list[str]:
    return list(dict.fromkeys(name for item in judged for name in (item.estimate, item.truth, item.std) if name))
