"""Running a query on one table, with errors that name it."""

import polars as pl

from roadperc_stream.errors import TableError


def collect(frame: pl.LazyFrame, source: str) -> pl.DataFrame:
    """The rows of a query on one table.

    In memory: of a table of 10 000 rows that takes 25 ms, where the streaming engine takes 300.

    Raises:
        TableError: the data of ``source`` cannot be read.
    """
    try:
        return frame.collect(engine="in-memory")
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError) as error:
        cause = (str(error).splitlines() or [type(error).__name__])[0]
        raise TableError(f"{source}: its data cannot be read: {cause}") from error
