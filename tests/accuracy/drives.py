"""Logs of rendered scenes: each is rendered once without noise; noise is added afterwards. A folder keeps the logs.

The random numbers of a dump depend on (seed, frame, purpose). So a clean dump with added noise equals a dump that is
rendered with noise (depth to its resolution), in a tenth of the time.
"""

import hashlib
import json
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from roadperc_stream.cli import convert
from roadperc_stream.model.tag_tables import CARLA_FROM_0_9_14
from roadperc_stream.tools.scene import dump_files, noise
from roadperc_stream.tools.scene.job import PURPOSES, render_dump
from roadperc_stream.tools.scene.options import RenderOptions
from tests import course

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Drive:
    """A drive, and its number of seeds relative to the usual one; ``options`` have no noise and no seed."""

    name: str
    options: RenderOptions
    seeds: float = 1.0
    pitch_is_unknown: bool = False
    """Whether the log says that the camera is mounted level."""


@dataclass(frozen=True)
class Noise:
    """Noise: shares as in ``roadperc-render``, and the quality if tags are saved as JPEG."""

    tags: float = 0.0
    depth: float = 0.0
    jpeg_quality: int | None = None

    @property
    def name(self):
        """The name in file names."""
        jpeg = f"-jpeg{self.jpeg_quality}" if self.jpeg_quality else ""
        return f"t{100 * self.tags:02.0f}-d{100 * self.depth:02.0f}{jpeg}"


@dataclass(frozen=True)
class Excerpt:
    """Every ``step``-th frame of a sequence in KITTI's layout at 10 Hz; a negative step runs backwards."""

    folder: str
    step: int

    @property
    def name(self):
        """The name in file names."""
        return f"{Path(self.folder).name}-{self.step}"

    def write(self, folder):
        """Write the frames as a sequence into a folder; returns the options with which it is converted."""
        source = Path(self.folder)
        (folder / "image_0").mkdir(parents=True, exist_ok=True)
        shutil.copy(source / "calib.txt", folder)
        for k, picture in enumerate(sorted((source / "image_0").iterdir())[:: self.step]):
            shutil.copy(picture, folder / "image_0" / f"{k:06d}.png")
        lines = (source / "poses.txt").read_text().splitlines()[:: self.step]
        (folder / "poses.txt").write_text("\n".join(lines) + "\n")
        return ("--rate", f"{10 / abs(self.step):g}")


@dataclass(frozen=True)
class CoursePair:
    """The course's stereo pair as its public solutions take it."""

    folder: str
    name = "course-pair"

    def write(self, folder):
        """Write the pair as a dump into a folder; returns the options with which it is converted."""
        course.write_dump(Path(self.folder), folder)
        return ()


def drive(name, seeds=1.0, *, pitch_is_unknown=False, **options):
    """A drive of the usual size."""
    usual = {"width": 640, "height": 480, "rate_hz": 10.0, "without": ("right",)}
    return Drive(name, RenderOptions(**(usual | options)), seeds, pitch_is_unknown)


def digest_of(options):
    """A digest of the options and the renderer's sources, so that a change renders the logs again."""
    digest = hashlib.sha256(repr(options).encode())
    for path in sorted((ROOT / "tools").rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:8]


def make_logs(cache, of, seed, noises):
    """The paths of a drive's logs by kind of noise; existing logs are kept."""
    folder = cache / f"{of.name}-{digest_of(of.options)}"
    targets = {kind: folder / f"{seed}-{kind.name}.mcap" for kind in noises}
    wanted = {kind: target for kind, target in targets.items() if not target.exists()}
    clean = cache / f"{of.name}-{seed}-dump"
    if wanted:
        render_dump(clean, replace(of.options, seed=seed), force=True)
        if of.pitch_is_unknown:
            hide_pitch(clean, of.options.mount)
    for kind, target in wanted.items():
        target.parent.mkdir(parents=True, exist_ok=True)
        noisy = cache / f"{of.name}-{seed}-noisy"
        with_noise(clean, noisy, seed, kind)
        if convert.main([str(noisy), str(target), "--quiet", "--allow-lossy-tags"]) != 0:
            raise RuntimeError(f"{noisy}: cannot be converted")
        shutil.rmtree(noisy)
    shutil.rmtree(clean, ignore_errors=True)
    return targets


def hide_pitch(dump_folder, mount):
    """Mount the cameras level in the calibration, and turn the true lanes with them: they stay at their pixels."""
    calibration, truth = (json.loads((dump_folder / f"{name}.json").read_text()) for name in ("calibration", "truth"))
    for mounting in calibration["mounting"].values():
        mounting["pitch"] = 0.0
    centre = np.array([mount[0], 0.0 - mount[1], mount[2]])
    level_R_true = Rotation.from_euler("y", mount[4], degrees=True)
    for lanes in truth["lanes"].values():
        for side in lanes.values():
            if isinstance(side, dict):
                side["line_ego_m"] = (level_R_true.apply(np.array(side["line_ego_m"]) - centre) + centre).tolist()
    for name, content in (("calibration", calibration), ("truth", truth)):
        dump_files.write_json(dump_folder / f"{name}.json", content)


def with_noise(clean, noisy, seed, kind):
    """Write a copy of a clean dump with noise, with the clean images as truth; tags as JPEG have CARLA's colours."""
    shutil.rmtree(noisy, ignore_errors=True)
    shutil.copytree(clean, noisy)
    changed = {"segmentation": kind.tags or kind.jpeg_quality, "depth": kind.depth}
    for name in (name for name, is_changed in changed.items() if is_changed):
        shutil.copytree(clean / name, noisy / "truth" / name)
    for picture in sorted((noisy / "segmentation").iterdir()) if changed["segmentation"] else ():
        tags = cv2.imread(str(picture))[..., 2]
        if kind.tags:
            tags = noise.noisy_tags(tags, kind.tags, random_of(seed, picture, "tags"))
        write_tags(picture, tags, kind.jpeg_quality)
    for picture in sorted((noisy / "depth").iterdir()) if kind.depth else ():
        depth_m = noise.noisy_depth(depth_of(picture), kind.depth, random_of(seed, picture, "depth"))
        dump_files.write_picture(picture, dump_files.depth_picture(depth_m))


def write_tags(path, tags, jpeg_quality):
    """Write tags as raw PNG, or as colours in a JPEG."""
    if jpeg_quality is None:
        dump_files.write_picture(path, dump_files.tags_picture(tags))
        return
    colours = np.array(CARLA_FROM_0_9_14.colours, np.uint8)
    cv2.imwrite(str(path.with_suffix(".jpg")), colours[tags][..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality])
    path.unlink()


def depth_of(picture):
    """(H, W) depth in metres of a clean depth image."""
    blue, green, red = (cv2.imread(str(picture)).astype(np.float64)[..., c] for c in range(3))
    return ((red + 256 * green + 65536 * blue) * (1000 / dump_files.DEPTH_CODES)).astype(np.float32)


def random_of(seed, picture, purpose):
    """The random numbers for the noise of an image, as in the renderer."""
    return np.random.default_rng((seed, int(picture.stem), PURPOSES[purpose]))
