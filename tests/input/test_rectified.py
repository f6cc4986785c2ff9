"""A log whose camera has a lens gives the results of the log that was recorded without it."""

from dataclasses import replace

import cv2
import numpy as np
import polars as pl
import pytest

import roadperc_stream as rp
from roadperc_stream import log
from roadperc_stream.cli import replay
from roadperc_stream.formats import images
from roadperc_stream.geometry import Lens
from roadperc_stream.geometry.rectification import lens_fault, lens_of, rectification_maps, rectified_pixels
from roadperc_stream.geometry.rotations import rotation_from_rpy
from roadperc_stream.input.rectified import rectified_frame
from roadperc_stream.input.stream import Problems
from roadperc_stream.model import Box, Detection
from roadperc_stream.output import encoding
from roadperc_stream.view.rerun import save_recording
from roadperc_stream.view.result_frames import read_frames
from tests import logs
from tests.analytic import TABLE
from tests.logs import SMALL, START_NS, Item
from tests.view.rerun.chunks import recorded as recorded_by_rerun

CAMERA = SMALL.camera
LENS = Lens(150.0, 150.0, 161.0, 118.0, Lens.R, "plumb_bob")
BARREL = replace(CAMERA, distortion=(-0.25, 0.06, 0.001, 0.0, -0.005), lens=LENS)
FISHEYE = replace(CAMERA, distortion=(-0.05, 0.01, -0.004, 0.001), lens=replace(LENS, model="equidistant"))
TURNED = replace(BARREL, lens=replace(LENS, R=tuple(rotation_from_rpy(0.02, 0.01, -0.02).ravel().tolist())))


def through_lens(camera, values):
    """(H, W) the values that the lens shows where the rectified image has ``values``."""
    if lens_fault(camera):
        return values
    straight = replace(camera, lens=replace(lens_of(camera), R=Lens.R))
    rows, columns = np.indices(camera.size, dtype=float)
    pixels = rectified_pixels(straight, CAMERA, np.stack((columns, rows), axis=-1).reshape(-1, 2))
    at = pixels.reshape(*camera.size, 2).astype(np.float32)
    border = np.nan if values.dtype.kind == "f" else 0
    return cv2.remap(values, at[..., 0], at[..., 1], cv2.INTER_NEAREST, borderValue=border)


def recorded(path, camera, frames=4):
    """A log of the road, seen by a camera behind its lens."""
    items = [item for item in logs.items(0) if item.role == "tf"]
    items.append(Item("calibration", START_NS, encoding.encode_calibration(START_NS, camera)))
    for k in range(frames):
        stamp, road = START_NS + k * 50_000_000, logs.shifted(SMALL, k)
        tags, depth_m = through_lens(camera, road.tags()), through_lens(camera, road.depth_m())
        png = cv2.imencode(".png", tags * 10)[1].tobytes()
        box = box_in(camera)
        items += [
            Item("image", stamp, encoding.encode_image(stamp, "camera", "png", png)),
            Item("depth", stamp, encoding.encode_depth(stamp, "camera", depth_m)),
            Item(
                "segmentation",
                stamp,
                encoding.encode_image(stamp, "camera", "png", images.encode_indices(tags, TABLE.colours)),
            ),
            Item("detections", stamp, encoding.encode_detections(stamp, "camera", [Detection("Car", box, 0.9)])),
        ]
    return logs.write(path, items)


def box_in(camera):
    """The box around the pixels that show the car behind the lens."""
    mask = np.zeros(camera.size, np.uint8)
    mask[130:160, 180:220] = 1
    rows, columns = np.nonzero(through_lens(camera, mask))
    return Box(columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)


def results(path):
    out = path.with_name(f"{path.stem}.out.mcap")
    assert replay.main([str(path), str(out), "--quiet"]) == 0
    return pl.read_parquet(out.with_name(f"{path.stem}.out.metrics.parquet")), out


def reasons_of(table):
    return table["reason_codes"].explode().drop_nulls().to_list()


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return results(recorded(tmp_path_factory.mktemp("plain") / "in.mcap", CAMERA))[0]


@pytest.mark.parametrize("camera", [BARREL, FISHEYE, TURNED], ids=["plumb_bob", "equidistant", "turned"])
def test_a_lens_is_undone_before_the_chain(tmp_path, plain, camera):
    table, out = results(recorded(tmp_path / "in.mcap", camera))
    for column, tolerance in (("lane_left_offset_m", 0.03), ("lane_right_offset_m", 0.03), ("camera_height_m", 0.01)):
        np.testing.assert_allclose(table[column].to_list(), plain[column].to_list(), atol=tolerance)
    assert not [reason for reason in reasons_of(table) if reason.startswith("image.")]
    frame = next(iter(rp.frames(out)))
    assert frame.input.camera == CAMERA
    (found,) = frame.input.detections
    sides = [found.box_px.x_min, found.box_px.y_min, found.box_px.x_max, found.box_px.y_max]
    np.testing.assert_allclose(sides, [180, 130, 220, 160], atol=2.5)
    save_recording(out, tmp_path / "out.rrd", {})
    (shown, *_) = recorded_by_rerun(tmp_path / "out.rrd")["/camera/front/image"].column("EncodedImage:blob")
    in_video = next(read_frames(log.summarise(out), Problems()))[1].image_bgr
    for picture in (images.decode_bgr(bytes(shown[0])), in_video):
        assert np.abs(picture[..., 0] - 10.0 * SMALL.tags()).mean() < 2


def test_a_lens_that_is_unknown_is_reported_and_its_image_used_as_it_is(tmp_path):
    unknown = replace(BARREL, lens=replace(LENS, model="division"))
    table, _ = results(recorded(tmp_path / "in.mcap", replace(CAMERA, distortion=(0.1,), lens=unknown.lens)))
    assert reasons_of(table).count("image.not_rectified") == 4


def test_pixels_outside_the_image_are_unknown(tmp_path):
    frame = SMALL.frame(camera=replace(BARREL, fx=60.0, fy=60.0), depth_camera=replace(BARREL, fx=60.0, fy=60.0))
    found = rectified_frame(frame)
    *_, valid = rectification_maps(replace(BARREL, fx=60.0, fy=60.0), found.camera)
    assert not valid[0, 0]
    assert found.segmentation.tags[0, 0] == 0
    assert np.isnan(found.depth_image.depth_m[0, 0])


def test_an_image_of_another_size_keeps_its_size():
    frame = SMALL.frame(camera=replace(BARREL, width=640, height=480, lens=replace(LENS, fx=300.0, fy=300.0)))
    assert rectified_frame(frame).segmentation.tags.shape == SMALL.frame().segmentation.tags.shape


def test_the_chain_in_python_undoes_a_lens(tmp_path):
    chain, straight = (rp.Chain(camera, tag_table="0.9.13") for camera in (BARREL, CAMERA))
    depth_m, tags = SMALL.depth_m(), SMALL.tags()
    found = chain.step(1, depth_m=through_lens(BARREL, depth_m), tags=through_lens(BARREL, tags))
    expected = straight.step(1, depth_m=depth_m, tags=tags)
    assert found.surface.camera_height_m == pytest.approx(expected.surface.camera_height_m, abs=0.01)
    assert found.lanes.side("left").offset_m == pytest.approx(expected.lanes.side("left").offset_m, abs=0.03)
