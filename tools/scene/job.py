"""Render a scenario into a dump: files in CARLA's formats with exact ground truth, frame by frame."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.output.terminal import frame_progress
from roadperc_stream.system.text import print_line

from . import dump_files, noise
from .cameras import CameraPair, make_rig, scan
from .object_truth import objects_truth
from .options import SENSORS, TRUTH, RenderOptions
from .scenario import Scenario
from .scenes import make_scene
from .truth import lanes_truth, surface_truth
from .view import Snapshot, View

PURPOSES: Final = {name: number for number, name in enumerate(("detections", "tags", "depth", "rgb", "right", "drop"))}


def render_and_report(folder: Path, options: RenderOptions, *, force: bool) -> None:
    """Render a scenario into a folder with a progress bar, and print the time.

    Raises:
        DumpError: an option is wrong, or the folder is in use.
    """
    started = time.perf_counter()
    with frame_progress("rendering", enabled=True) as progress:
        done = count(1)
        render_dump(folder, options, force=force, on_frame=lambda: progress(next(done), options.frames))
    seconds = time.perf_counter() - started
    size, rate = f"{options.width}x{options.height}", options.frames / seconds
    print_line(f"{options.frames} frames of {size} in {seconds:.1f} s ({rate:.1f} frames/s): {folder}")


def render_dump(
    folder: Path, options: RenderOptions, *, force: bool, on_frame: Callable[[], None] = lambda: None
) -> None:
    """Render a scenario into a folder; call ``on_frame`` after each frame.

    The folder appears when the dump is complete. With ``force`` it replaces an earlier dump.

    Raises:
        DumpError: an option is wrong, or the folder is in use.
    """
    options.check()
    cv2.setNumThreads(1)
    with dump_files.new_dump(folder, force=force) as hidden:
        scene = make_scene(options, 0.0 if options.static else options.speed_mps * options.seconds)
        scenario = Scenario.of(scene, options)
        job = _Job(hidden, options, scenario, make_rig(options))
        for frame in range(options.frames):
            job.add_frame(frame)
            on_frame()
        job.write_records()


@dataclass
class _Job:
    """An unfinished dump, and the contents of its JSON files by frame name."""

    folder: Path
    options: RenderOptions
    scenario: Scenario
    rig: CameraPair
    detections: dict[str, Any] = field(default_factory=dict)
    poses: dict[str, Any] = field(default_factory=dict)
    stamps: list[str] = field(default_factory=list)
    truth: dict[str, dict[str, Any]] = field(default_factory=lambda: {"lanes": {}, "surface": {}, "objects": {}})
    ids: dict[str, int] = field(default_factory=dict)
    """Number of each visible object by its name; numbers stay the same in all frames."""

    def add_frame(self, frame: int) -> None:
        """Write the files of a frame, except dropped ones, and record its truth."""
        options, rig, name = self.options, self.rig, f"{frame:06d}"
        snapshot = self.scenario.at(frame / options.rate_hz)
        world_T_camera = snapshot.world_T_ego @ rig.ego_T_left
        left = View(snapshot, rig.camera, world_T_camera, options.bonnet)
        objects = objects_truth(self.scenario, snapshot, rig, left, whole=options.whole_boxes)
        entries = [truth.to_json(with_path=options.knows_path) for truth in objects]
        self._write_pictures(frame, name, snapshot, left)
        if options.instances:
            ids = self._instances(snapshot, left)
            dump_files.write_picture(self._path(dump_files.INSTANCES, name), dump_files.tags_picture(left.tags, ids))
            for truth, entry in zip(objects, entries, strict=True):
                entry["instance_id"] = self.ids[truth.name]
        rng = self._rng(frame, "detections")
        self.detections[name] = noise.detect(snapshot, rig.camera, world_T_camera, objects, rng)
        self.poses[name] = dump_files.carla_transform(snapshot.world_T_ego)
        self.stamps.append(f"{name} {snapshot.time_s:.9f}\n")
        self.truth["lanes"][name] = lanes_truth(snapshot, with_change=options.knows_path)
        self.truth["surface"][name] = surface_truth(snapshot, rig)
        self.truth["objects"][name] = entries

    def write_records(self) -> None:
        """Write the JSON files and ``timestamps.txt``."""
        documents = {
            "calibration": dump_files.calibration(self.rig, self.options),
            "detections": self.detections,
        }
        if TRUTH not in self.options.without:
            documents |= {"poses": self.poses, "truth": self.truth}
        for name, content in documents.items():
            dump_files.write_json(self.folder / f"{name}.json", content)
        dump_files.write_file(self.folder / "timestamps.txt", "".join(self.stamps).encode())

    def _rng(self, frame: int, purpose: str) -> np.random.Generator:
        return np.random.default_rng((self.options.seed, frame, PURPOSES[purpose]))

    def _path(self, sensor: str, name: str) -> Path:
        jpeg = self.options.jpeg and sensor in ("rgb", "right")
        return self.folder / sensor / f"{name}{'.jpg' if jpeg else '.png'}"

    def _instances(self, snapshot: Snapshot, view: View) -> NDArray[np.int32]:
        """Return (H, W) the object number of each pixel, the same in all frames; 0 for none."""
        of_owner = np.zeros(len(snapshot.bodies) + 1, np.int32)
        for owner in np.unique(view.owner[view.owner > 0]):
            of_owner[owner] = self.ids.setdefault(snapshot.bodies[owner - 1].name, len(self.ids) + 1)
        return of_owner[view.owner]

    def _write_pictures(self, frame: int, name: str, snapshot: Snapshot, left: View) -> None:
        options = self.options
        written = (self._rng(frame, "drop").random(len(SENSORS) + 1) >= options.drop) | (frame == 0)
        for sensor, keep in zip(SENSORS, written[:-1], strict=True):
            if keep and sensor not in options.without:
                dump_files.write_picture(self._path(sensor, name), self._picture(frame, sensor, snapshot, left))
        if options.lidar and written[-1]:
            dump_files.write_points(self.folder / dump_files.LIDAR / f"{name}.ply", scan(snapshot))
        if TRUTH in options.without:
            return
        if options.tag_noise or options.drop or "segmentation" in options.without:
            dump_files.write_picture(self._path("truth/segmentation", name), dump_files.tags_picture(left.tags))
        if options.depth_noise or options.drop or "depth" in options.without:
            dump_files.write_picture(self._path("truth/depth", name), dump_files.depth_picture(left.depth_m))

    def _picture(self, frame: int, sensor: str, snapshot: Snapshot, left: View) -> NDArray[np.uint8]:
        """Return the picture of a sensor, with the noise of the options."""
        options, rig = self.options, self.rig
        if sensor == "depth":
            share, depth_m = options.depth_noise, left.depth_m
            noisy_m = noise.noisy_depth(depth_m, share, self._rng(frame, "depth")) if share else depth_m
            return dump_files.depth_picture(noisy_m)
        if sensor == "segmentation":
            share, tags = options.tag_noise, left.tags
            return dump_files.tags_picture(noise.noisy_tags(tags, share, self._rng(frame, "tags")) if share else tags)
        right = sensor == "right"
        beside = snapshot.world_T_ego @ rig.ego_T_right
        rgb = View(snapshot, rig.camera, beside, options.bonnet).rgb if right else left.rgb
        if options.exposure is not None:
            rgb = noise.exposed(rgb, *noise.exposure_at(options.exposure, snapshot.time_s, frame, options.seed))
        return noise.noisy_rgb(rgb, options.rgb_noise, self._rng(frame, sensor)) if options.rgb_noise else rgb
