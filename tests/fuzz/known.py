"""Faults that are known and not yet mended: the one place that names them.

A corpus entry named in ``CORPUS`` must fail, so that its line goes when the fault is mended. A drawn case may have a
fault that one of ``FAULTS`` is part of: it is counted as known.
"""

_BOMB = "memory is not bounded by what a chunk states"
_BUFFER = "a stated length is read at once"
_TOML = "the configuration is parsed without bounds"
_PARQUET = "what polars and pyarrow raise is not stated"
_PRINTED = "a C library prints to stderr"
_SHOWN = "what came from a file is printed as it is"
_NUMBERS = "numbers beyond those of a drive are computed with"
_SLOW = "time is not bounded"

CORPUS: dict[str, str] = {
    "attached-config-of-5000-digits-in-info": _TOML,
    "attached-config-of-50000-keys-in-info": _TOML,
    "bomb-of-zstd": _BOMB,
    "bomb-of-zstd-in-info": _BOMB,
    "bomb-of-zstd-that-states-little": _BOMB,
    "columns-of-nulls-in-page": _NUMBERS,
    "columns-of-nulls-in-report": _NUMBERS,
    "config-with-100000-lists": _TOML,
    "config-with-50000-dotted-keys": _TOML,
    "config-with-a-number-of-5000-digits": _TOML,
    "detections-20000": _SLOW,
    "dump-whose-png-makes-libpng-speak": _PRINTED,
    "escapes-in-a-schema-name": _SHOWN,
    "escapes-in-a-topic": _SHOWN,
    "escapes-in-facts": _SHOWN,
    "floats-of-1e308-in-page": _NUMBERS,
    "floats-of-1e308-in-report": _NUMBERS,
    "header-that-claims-10-gb": _BUFFER,
    "index-that-claims-10-gb": _BUFFER,
    "libjpeg-speaks": _PRINTED,
    "libpng-speaks": _PRINTED,
    "libpng-speaks-of-checksums": _PRINTED,
    "lidar-calibration-of-40000x40000": _BUFFER,
    "parquet-of-wide-integers": _PARQUET,
    "parquet-that-panics-in-an-assertion": _PARQUET,
    "parquet-that-panics-in-unwrap": _PARQUET,
    "parquet-whose-error-has-control-characters": _SHOWN,
    "parquet-with-a-name-that-is-no-utf8": _PARQUET,
    "png-of-30000x30000": _SLOW,
    "png-of-30000x30000-in-overlay": _SLOW,
    "record-that-claims-2-gb": _BUFFER,
    "transforms-50000": _SLOW,
}
FAULTS: tuple[str, ...] = (
    "MemoryError", "Unable to allocate", "OutOfMemoryError", "Failed to allocate", "hang: ", "died: ",
    "loading.py:", "settings.py:settings_in", "PanicException", "runs.py:open_run", "scan.py:collect", "RuntimeWarning",
    "libpng ", "JPEG", "grfmt_", "control character", "begins a line of its own", "a line of ",
)  # fmt: skip


def is_known(case: str, fault: str) -> bool:
    """Whether a case may have this fault for now."""
    return case in CORPUS or any(part in fault for part in FAULTS)
