"""The figures of a dataset: those of its groups, and the names of its logs and configurations."""

from collections.abc import Mapping, Sequence
from functools import cached_property

import polars as pl

from roadperc_stream.output.text_table import Table

from ..configurations import Settings, table_of_settings
from ..summaries import Summary
from .groups import GroupedFrames, group_frames, summaries_of
from .keys import DEFAULT, in_order_of_runs, log_names, settings_by_config
from .place import Dataset, metrics_files, read_runs


class SummedDataset:
    """A dataset whose frames are grouped ``by`` columns; without them by configuration, and version if they differ.

    ``runs`` is its list of runs, and ``files`` are its metrics tables. The other properties read these tables.

    Raises:
        TableError: a table cannot be read, or a column does not exist.
    """

    def __init__(self, dataset: Dataset, by: Sequence[str]) -> None:
        self._by = by
        self.runs, self.files = read_runs(dataset), metrics_files(dataset)

    @cached_property
    def groups(self) -> GroupedFrames:
        """The groups of frames."""
        return group_frames(self.files, self.runs, self._by)

    @property
    def logs(self) -> pl.DataFrame:
        """A row for each log and configuration, from ``logs_of``."""
        return self.groups.logs

    @cached_property
    def configs(self) -> list[str]:
        """The configurations in the order of their first finished run."""
        return in_order_of_runs(self.logs["config"].unique(maintain_order=True).to_list(), self.runs)

    @cached_property
    def names(self) -> dict[str, str]:
        """The names of the logs by ``log_id``."""
        return log_names(self.logs["log_id"].unique(maintain_order=True), self.runs)

    @cached_property
    def summaries(self) -> list[Summary]:
        """The figures of each group."""
        return summaries_of(self.groups, self.names, self.configs)

    @property
    def settings(self) -> Table:
        """The settings that differ between configurations."""
        return settings_that_differ(settings_by_config(self.runs, self.configs))


def settings_that_differ(known: Mapping[str, Settings | None]) -> Table:
    """The settings and options that differ between configurations.

    ``known`` has the non-default settings of each configuration; None if unknown.
    """
    keys = dict.fromkeys(key for settings in known.values() for key in settings or ())
    whole = {
        config: None if settings is None else {key: settings.get(key, DEFAULT) for key in keys}
        for config, settings in known.items()
    }
    return table_of_settings(whole)
