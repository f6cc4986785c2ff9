"""A drive rendered in CARLA's own file formats, with exact ground truth."""

import time
from itertools import count
from pathlib import Path

from roadperc_stream.output.terminal import frame_progress
from roadperc_stream.system.text import print_line

from .scene.job import render_dump
from .scene.options import RenderOptions


def render(dump: Path, options: RenderOptions, *, force: bool) -> None:
    """Render a drive into a folder, and say how long it took.

    Raises:
        DumpError: an option or the folder does not do.
    """
    options.check()
    started = time.perf_counter()
    with frame_progress("rendering", enabled=True) as progress:
        done = count(1)
        render_dump(dump, options, force=force, on_frame=lambda: progress(next(done), options.frames))
    seconds = time.perf_counter() - started
    size, rate = f"{options.width}x{options.height}", options.frames / seconds
    print_line(f"{options.frames} frames of {size} in {seconds:.1f} s ({rate:.1f} frames/s): {dump}")
