"""One rendering job: the loop from frame to files."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from . import dump, noise
from .drive import Drive, SceneMoment
from .noise import detect
from .object_truth import ObjectTruth, objects_truth
from .options import SENSORS, RenderOptions
from .rig import CameraPair, make_rig, scan
from .truth import lanes_truth, surface_truth
from .view import RenderedView, photograph, render
from .world import make_world

PURPOSES: Final = {name: number for number, name in enumerate(("detections", "tags", "depth", "rgb", "right", "drop"))}


@dataclass
class _Records:
    """What the JSON files say, frame by frame."""

    detections: dict[str, Any] = field(default_factory=dict)
    poses: dict[str, Any] = field(default_factory=dict)
    stamps: list[str] = field(default_factory=list)
    lanes: dict[str, Any] = field(default_factory=dict)
    surface: dict[str, Any] = field(default_factory=dict)
    objects: dict[str, Any] = field(default_factory=dict)
    ids: dict[str, int] = field(default_factory=dict)
    """Number of each thing that has come into view, by its name."""

    def instances(self, moment: SceneMoment, view: RenderedView) -> NDArray[np.int32]:
        """(H, W) number of the thing in each pixel through all of the drive, 0 for none."""
        of_owner = np.zeros(len(moment.things) + 1, np.int32)
        for owner in np.unique(view.owner[view.owner > 0]):
            of_owner[owner] = self.ids.setdefault(moment.things[owner - 1].name, len(self.ids) + 1)
        return of_owner[view.owner]


def render_dump(folder: Path, options: RenderOptions, *, force: bool, on_frame: Callable[[], None]) -> None:
    """Renders a drive into a folder.

    Args:
        folder: there when the dump is complete; an interrupted one leaves nothing.
        options: what to render.
        force: whether an earlier dump in the folder may be replaced.
        on_frame: called after each frame.

    Raises:
        DumpError: an option or the folder does not do.
    """
    options.check()
    cv2.setNumThreads(1)
    with dump.new_dump(folder, force=force) as hidden:
        _render(hidden, options, on_frame)


def _render(folder: Path, options: RenderOptions, on_frame: Callable[[], None]) -> None:
    world = make_world(options, 0.0 if options.static else options.speed_mps * options.seconds)
    drive = Drive.of(world, options)
    rig = make_rig(options.width, options.height, options.fov_deg, options.mount)
    records = _Records()
    for frame in range(options.frames):
        moment = drive.at(frame / options.rate_hz)
        left = render(moment.scenery, rig.camera, moment.world_T_ego @ rig.ego_T_left)
        objects = objects_truth(drive, moment, rig, left, whole=options.whole_boxes)
        _write_frame(folder, options, frame, moment, rig, left)
        if options.instances:
            picture = dump.instance_picture(left.tags, records.instances(moment, left))
            dump.write_picture(folder / dump.INSTANCES / f"{frame_name(frame)}.png", picture)
        _record(records, options, frame, moment, rig, objects)
        on_frame()
    _write_records(folder, options, rig, records)


def _rng(options: RenderOptions, frame: int, purpose: str) -> np.random.Generator:
    return np.random.default_rng((options.seed, frame, PURPOSES[purpose]))


def frame_name(frame: int) -> str:
    """Six digits, as CARLA's own recorders write them."""
    return f"{frame:06d}"


def _write_frame(
    folder: Path, options: RenderOptions, frame: int, moment: SceneMoment, rig: CameraPair, left: RenderedView
) -> None:
    """The files of one frame, but for those that are dropped."""
    suffix = ".jpg" if options.jpeg else ".png"
    name = frame_name(frame)
    kept = (_rng(options, frame, "drop").random(len(SENSORS) + 1) >= options.drop) | (frame == 0)
    for sensor, keep in zip(SENSORS, kept[:-1], strict=True):
        if keep and sensor not in options.without:
            picture = _picture(options, frame, sensor, moment, rig, left)
            dump.write_picture(folder / sensor / (name + (suffix if sensor in ("rgb", "right") else ".png")), picture)
    if options.lidar and kept[-1]:
        dump.write_points(folder / dump.LIDAR / f"{name}.ply", scan(moment))
    if options.tag_noise or options.drop or "segmentation" in options.without:
        dump.write_picture(folder / "truth" / "segmentation" / f"{name}.png", dump.tags_picture(left.tags))
    if options.depth_noise or options.drop or "depth" in options.without:
        dump.write_picture(folder / "truth" / "depth" / f"{name}.png", dump.depth_picture(left.depth_m))


def _picture(
    options: RenderOptions, frame: int, sensor: str, moment: SceneMoment, rig: CameraPair, left: RenderedView
) -> NDArray[np.uint8]:
    """What a sensor's file shows, with the noise asked for."""
    if sensor == "depth":
        share = options.depth_noise
        depth = noise.noisy_depth(left.depth_m, share, _rng(options, frame, "depth")) if share else left.depth_m
        return dump.depth_picture(depth)
    if sensor == "segmentation":
        share = options.tag_noise
        return dump.tags_picture(
            noise.noisy_tags(left.tags, share, _rng(options, frame, "tags")) if share else left.tags
        )
    rgb = left.rgb
    if sensor == "right":
        rgb = photograph(moment.scenery, rig.camera, moment.world_T_ego @ rig.ego_T_right)
    return noise.noisy_rgb(rgb, options.rgb_noise, _rng(options, frame, sensor)) if options.rgb_noise else rgb


def _record(
    records: _Records,
    options: RenderOptions,
    frame: int,
    moment: SceneMoment,
    rig: CameraPair,
    objects: list[ObjectTruth],
) -> None:
    name = frame_name(frame)
    world_T_camera = moment.world_T_ego @ rig.ego_T_left
    found = detect(moment, rig.camera, world_T_camera, objects, _rng(options, frame, "detections"))
    records.detections[name] = [detection.to_json() for detection in found]
    records.poses[name] = dump.carla_transform(moment.world_T_ego)
    records.stamps.append(f"{name} {moment.time_s:.9f}\n")
    records.lanes[name] = lanes_truth(moment, with_change=options.knows_path)
    records.surface[name] = surface_truth(moment, rig)
    records.objects[name] = [truth.to_json(with_path=options.knows_path) for truth in objects]
    if options.instances:
        for truth, entry in zip(objects, records.objects[name], strict=True):
            entry["instance_id"] = records.ids[truth.name]


def _write_records(folder: Path, options: RenderOptions, rig: CameraPair, records: _Records) -> None:
    truth = {"lanes": records.lanes, "surface": records.surface, "objects": records.objects}
    dump.write_json(folder / "calibration.json", dump.calibration(rig, options.rate_hz, lidar=options.lidar))
    dump.write_json(folder / "detections.json", records.detections)
    dump.write_json(folder / "poses.json", records.poses)
    dump.write_json(folder / "truth.json", truth)
    dump.write_text(folder / "timestamps.txt", "".join(records.stamps))
