"""Rendered drives as logs: rendered once without noise, then made noisy as often as asked for, and kept in a folder.

Everything random of a dump follows from (seed, frame, purpose), so a clean dump with noise put in afterwards is the one
that is rendered with that noise (depths to the step they are stored in), in a tenth of the time.
"""

import hashlib
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from roadperc_stream.cli import convert
from roadperc_stream.model.tag_tables import CARLA_FROM_0_9_14
from roadperc_stream.tools.scene import dump, noise
from roadperc_stream.tools.scene.job import PURPOSES, render_dump
from roadperc_stream.tools.scene.options import RenderOptions

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Drive:
    """What is rendered, over a share of all seeds; ``options`` have neither noise nor seed."""

    name: str
    options: RenderOptions
    seeds: float = 1.0


@dataclass(frozen=True)
class Noise:
    """What is done to a drive: shares as of ``roadperc-render``, and the quality of tags that are saved as JPEG."""

    tags: float = 0.0
    depth: float = 0.0
    jpeg_quality: int | None = None

    @property
    def name(self):
        """For files' names."""
        jpeg = f"-jpeg{self.jpeg_quality}" if self.jpeg_quality else ""
        return f"t{100 * self.tags:02.0f}-d{100 * self.depth:02.0f}{jpeg}"


def drive(name, seeds=1.0, **options):
    """A drive of the usual size."""
    usual = {"width": 640, "height": 480, "rate_hz": 10.0, "without": ("right",)}
    return Drive(name, RenderOptions(**(usual | options)), seeds)


def digest_of(options):
    """Of all that decides a rendered log's bytes, so that no log is older than what it is rendered by."""
    digest = hashlib.sha256(repr(options).encode())
    for path in sorted((ROOT / "tools").rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:8]


def make_logs(cache, of, seed, noises):
    """The log of a drive under each of several kinds of noise, by noise; what is there is not made again."""
    folder = cache / f"{of.name}-{digest_of(of.options)}"
    targets = {kind: folder / f"{seed}-{kind.name}.mcap" for kind in noises}
    wanted = {kind: target for kind, target in targets.items() if not target.exists()}
    clean = cache / f"{of.name}-{seed}-dump"
    if wanted:
        render_dump(clean, replace(of.options, seed=seed), force=True, on_frame=lambda: None)
    for kind, target in wanted.items():
        target.parent.mkdir(parents=True, exist_ok=True)
        noisy = cache / f"{of.name}-{seed}-noisy"
        with_noise(clean, noisy, seed, kind)
        if convert.main([str(noisy), str(target), "--quiet", "--allow-lossy-tags"]) != 0:
            raise RuntimeError(f"{noisy}: cannot be converted")
        shutil.rmtree(noisy)
    shutil.rmtree(clean, ignore_errors=True)
    return targets


def with_noise(clean, noisy, seed, kind):
    """A copy of a clean dump as it would be rendered with noise; tags as JPEG are colours, as CARLA shows them."""
    shutil.rmtree(noisy, ignore_errors=True)
    shutil.copytree(clean, noisy)
    for picture in sorted((clean / "segmentation").iterdir()) if kind.tags or kind.jpeg_quality else ():
        keep_truth(noisy, picture)
        tags = cv2.imread(str(picture))[..., 2]
        if kind.tags:
            tags = noise.noisy_tags(tags, kind.tags, random_of(seed, picture, "tags"))
        write_tags(noisy / "segmentation" / picture.name, tags, kind.jpeg_quality)
    for picture in sorted((clean / "depth").iterdir()) if kind.depth else ():
        keep_truth(noisy, picture)
        depth_m = noise.noisy_depth(depth_of(picture), kind.depth, random_of(seed, picture, "depth"))
        dump.write_picture(noisy / "depth" / picture.name, dump.depth_picture(depth_m))


def keep_truth(noisy, picture):
    """The clean picture of a sensor as the truth of a dump."""
    truth = noisy / "truth" / picture.parent.name
    truth.mkdir(parents=True, exist_ok=True)
    shutil.copy(picture, truth / picture.name)


def write_tags(path, tags, jpeg_quality):
    """Raw tags as PNG, or colours as JPEG of a quality."""
    if jpeg_quality is None:
        dump.write_picture(path, dump.tags_picture(tags))
        return
    colours = np.array(CARLA_FROM_0_9_14.colours, np.uint8)
    cv2.imwrite(str(path.with_suffix(".jpg")), colours[tags][..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality])
    path.unlink()


def depth_of(picture):
    """(H, W) metres of a clean depth picture."""
    blue, green, red = (cv2.imread(str(picture)).astype(np.float64)[..., c] for c in range(3))
    return ((red + 256 * green + 65536 * blue) * (1000 / dump.DEPTH_CODES)).astype(np.float32)


def random_of(seed, picture, purpose):
    """What decides the noise of a picture, as the renderer has it."""
    return np.random.default_rng((seed, int(picture.stem), PURPOSES[purpose]))
