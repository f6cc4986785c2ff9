"""``--template``: the picture of an obstacle, from an image file or from a box in a frame of the log."""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from roadperc_stream.chain.stages.objects.template import png_of
from roadperc_stream.config import DEFAULT_LIMITS, ReplayConfig
from roadperc_stream.config.loading import validated
from roadperc_stream.config.stages import MOST_PNG_BYTES
from roadperc_stream.errors import ConfigError, DecodeError
from roadperc_stream.formats.images import decode_grey
from roadperc_stream.input import ReplaySource, open_input
from roadperc_stream.model import Image
from roadperc_stream.system.files import read_file

_IN_FRAME: Final = re.compile(r"(\d{1,9}):(\d{1,9}),(\d{1,9}),(\d{1,9}),(\d{1,9})")
_EXPECTED: Final = "expected an image file, or FRAME:X0,Y0,X1,Y1 with X0 < X1 and Y0 < Y1"
_LEAST_PX: Final = 8
"""Least rows and columns of a picture."""


def with_template(cfg: ReplayConfig, option: str | None, source: ReplaySource) -> ReplayConfig:
    """The configuration with the picture in ``objects.template_png``.

    ``option`` is a file, or ``FRAME:X0,Y0,X1,Y1`` with frames counted from 0 and a half-open box. None changes nothing.

    Raises:
        ConfigError: the file or the frame does not exist, or the picture is unsuitable.
    """
    if option is None:
        return cfg
    place = _IN_FRAME.fullmatch(option)
    grey = _of_file(Path(option)) if place is None else _of_frame(cfg, source, [int(n) for n in place.groups()])
    height, width = grey.shape
    if min(height, width) < _LEAST_PX or grey.min() == grey.max():
        shown = "all of one brightness" if min(height, width) >= _LEAST_PX else f"{width}x{height} pixels"
        raise ConfigError(f"--template: expected a picture of {_LEAST_PX}x{_LEAST_PX} pixels or more, found {shown}")
    png = png_of(grey)
    if len(png) > MOST_PNG_BYTES:
        raise ConfigError(f"--template: a picture of {width}x{height} pixels is too large: {len(png)} bytes as a PNG")
    settings = cfg.model_dump()
    settings["objects"]["template_png"] = png
    return validated(settings, "--template: ")


def _of_file(path: Path) -> Image:
    try:
        return decode_grey(read_file(path, DEFAULT_LIMITS.message_bytes))
    except OSError as error:
        raise ConfigError(f"--template: {path}: {error.strerror}; {_EXPECTED}") from error
    except DecodeError as error:
        raise ConfigError(f"--template: {path}: {error}") from error


def _of_frame(cfg: ReplayConfig, source: ReplaySource, place: Sequence[int]) -> Image:
    frame, x0, y0, x1, y1 = place
    if Path("-") in source.files:
        raise ConfigError("--template: a box in a frame needs a log in a file, because it is read twice; expected no -")
    first = replace(source.time_range, frames=frame + 1)
    samples = open_input(replace(source, time_range=first), cfg).samples()
    image = next((sample.frame.image for sample in samples if sample.index == frame), None)
    if image is None:
        raise ConfigError(f"--template: the log has no image in frame {frame}; {_EXPECTED}")
    height, width = image.grey.shape
    if not (x0 < x1 <= width and y0 < y1 <= height):
        found = f"{x0},{y0},{x1},{y1}"
        raise ConfigError(f"--template: {_EXPECTED} within {width}x{height} pixels, found {found}")
    return image.grey[y0:y1, x0:x1].copy()
