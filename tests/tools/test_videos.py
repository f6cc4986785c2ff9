"""Videos and plain images become logs, with their own times."""

import json
import struct
from itertools import islice

import cv2
import pytest

from roadperc_stream import log
from roadperc_stream.cli.convert import main
from roadperc_stream.geometry import Camera
from roadperc_stream.tools.video_file import ReadCounts, frames_of, open_video
from tests.tools.dump_writer import camera_pixels, document, jpeg
from tests.tools.test_conversion import convert, failure, payloads, printed_by
from tests.tools.video_writer import HEIGHT, WIDTH, frame_of, turned, with_times, write_video, write_with_gaps

FOV = ("--fov", "90")
TIMES_MS = (0, 50, 100, 300, 350, 1000, 1033, 1066, 1100, 1500, 1550, 1600)


def images(found):
    """(milliseconds, number of the frame) of all images."""
    return [(t / 1e6, frame_of(image.bgr)) for t, _, image in found["image"]]


@pytest.mark.parametrize(("name", "fourcc"), [("drive.mp4", "mp4v"), ("drive.mkv", "mp4v"), ("drive.avi", "MJPG")])
def test_a_video_becomes_a_log(tmp_path, name, fourcc):
    found = payloads(convert(write_video(tmp_path / name, fourcc=fourcc), *FOV, "--height", "1.3"))
    assert set(found) == {"image", "calibration", "tf"}
    assert images(found) == [(50 * k, k) for k in range(12)]
    ((_, _, camera),) = found["calibration"]
    assert camera == Camera("camera_front", WIDTH, HEIGHT, 80.0, 80.0, 79.5, 59.5)
    ((edge,),) = [edges for _, _, edges in found["tf"]]
    assert (edge.parent, edge.child, edge.parent_T_child[:3, 3].tolist()) == ("ego", "camera_front", [0, 0, 1.3])


def test_a_variable_frame_rate_is_respected(tmp_path):
    found = payloads(convert(with_times(write_video(tmp_path / "drive.mp4"), TIMES_MS), *FOV))
    assert images(found) == [(pytest.approx(ms, abs=0.1), k) for k, ms in enumerate(TIMES_MS)]


def test_a_whole_video_with_dropped_frames_is_not_called_cut(tmp_path, capsys):
    path, out = write_with_gaps(tmp_path / "drive.mkv"), tmp_path / "out.mcap"
    assert main([str(path), str(out), *FOV]) == 0
    printed = capsys.readouterr()
    assert "drive.mkv: 12 frames" in printed.out
    assert "6.667 Hz" in printed.out
    assert printed.err == ""
    assert images(payloads(out)) == [(150 * k, k) for k in range(12)]
    path.write_bytes(path.read_bytes()[:-3000])
    assert main([str(path), str(out), *FOV, "--force"]) == 0
    assert "the file is cut" in capsys.readouterr().err


def av1(path):
    """A video whose decoder OpenCV does not have."""
    made = write_video(path).read_bytes()
    path.write_bytes(made.replace(b"V_MPEG4/ISO/ASP", b"V_AV1".ljust(15, b"\0")))


def test_a_rotated_video_is_upright(tmp_path, capsys):
    path, out = turned(write_video(tmp_path / "drive.mp4")), tmp_path / "out.mcap"
    assert "120x160" in printed_by(capsys, path, out, *FOV)
    found = payloads(out)
    (_, _, camera) = found["calibration"][0]
    assert (camera.width, camera.height, camera.fx) == (HEIGHT, WIDTH, 60.0)
    corner = found["image"][0][2].bgr
    assert corner[:15, -15:].min() > 200  # the white corner turned from the left to the right
    assert corner[:15, :15, 2].max() < 100


def test_a_folder_of_videos_is_one_drive_in_the_order_of_the_numbers(tmp_path):
    folder = tmp_path / "dashcam"
    for part, first in ((10, 8), (9, 4), (1, 0)):
        write_video(folder / f"part{part}.mp4", frames=4, first=first)
    document(folder / "calibration.json", {"fov_deg": 90})
    assert images(payloads(convert(folder))) == [(50 * k, k) for k in range(12)]


def test_frames_after_damage_are_kept(tmp_path, capsys):
    path = write_video(tmp_path / "drive.avi", frames=40, fourcc="MJPG")
    data = bytearray(path.read_bytes())
    start = data.find(b"movi") + 4
    frame = data.find(b"00dc", start + 20000)
    (size,) = struct.unpack_from("<I", data, frame + 4)
    data[frame + 8 : frame + 8 + size] = bytes(size)
    path.write_bytes(data)
    out = tmp_path / "out.mcap"
    assert main([str(path), str(out), "--quiet", *FOV]) == 0
    found = images(payloads(out))
    assert len(found) == 39
    assert [ms for ms, _ in found][-1] == 50 * 39
    assert "39 of 40 frames could be read (1 damaged ones lie between them)" in capsys.readouterr().err


def without_frames(path):
    cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"MJPG"), 20, (160, 120)).release()


def cut_mp4(path):
    write_video(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


@pytest.mark.parametrize(
    ("name", "make", "words"),
    [
        ("empty.mp4", lambda path: path.write_bytes(b""), "not a video"),
        ("text.mp4", lambda path: path.write_text("hello" * 100), "not a video"),
        ("cut.mp4", cut_mp4, "without its index"),
        ("none.avi", without_frames, "video"),
        ("new.mkv", av1, "cannot decode its codec, AV01"),
    ],
)
def test_a_video_without_frames_is_an_error_that_names_it(tmp_path, capsys, name, make, words):
    make(tmp_path / name)
    line = failure(capsys, tmp_path / name, tmp_path / "out.mcap", *FOV)
    assert name in line
    assert words in line
    assert not (tmp_path / "out.mcap").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ((), "pass --fov DEGREES (horizontal field of view) or --calibration FILE"),
        ((*FOV, "--rate", "10"), "--rate is an option for folders of frames"),
        ((*FOV, "--carla", "0.9.15"), "--tags is an option for folders of frames"),
        (("--calibration", "nowhere.yaml"), "nowhere.yaml: No such file or directory"),
    ],
)
def test_what_is_missing_or_does_not_fit_a_video_is_named(tmp_path, capsys, options, words):
    path = write_video(tmp_path / "drive.mp4", frames=2)
    assert words in failure(capsys, path, tmp_path / "out.mcap", *options)


@pytest.mark.parametrize("inside", ["", "holiday"])
def test_images_of_any_name_are_the_front_camera(tmp_path, capsys, inside):
    folder, out = tmp_path / "shots", tmp_path / "out.mcap"
    for number in (7, 8, 9):
        jpeg(folder / inside / f"dashcam_{number}.jpg", camera_pixels(number))
    assert "taken as the images of the front camera" in printed_by(capsys, folder, out, *FOV, "--rate", "10")
    assert [t / 1e6 for t, _, _ in payloads(out)["image"]] == [0, 100, 200]


def test_a_real_video_is_read(data_dir):
    video = open_video(data_dir / "highway_video" / "solidWhiteRight.mp4")
    assert (video.width, video.height, video.rate_hz, video.count, video.codec) == (960, 540, 25.0, 221, "h264")
    frames = [(ns, pixels.shape) for ns, pixels in islice(frames_of(video, ReadCounts()), 5)]
    assert frames == [(40_000_000 * k, (540, 960, 3)) for k in range(5)]


def test_videos_of_two_sizes_are_refused(tmp_path, capsys):
    write_video(tmp_path / "cams" / "a.mp4")
    write_video(tmp_path / "cams" / "b.mp4", size=(80, 60))
    message = failure(capsys, tmp_path / "cams", tmp_path / "out.mcap", *FOV)
    assert "b.mp4: 80x60, expected 160x120 as a.mp4" in message


@pytest.mark.parametrize(("name", "fourcc"), [("drive.mkv", "MJPG"), ("drive.avi", "MJPG")])
def test_a_cut_video_is_converted_as_far_as_it_goes(tmp_path, capsys, name, fourcc):
    path = write_video(tmp_path / name, frames=40, fourcc=fourcc)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    out = tmp_path / "out.mcap"
    assert main([str(path), str(out), "--quiet", *FOV]) == 0
    count = len(payloads(out)["image"])
    assert 10 < count < 30
    assert f"{name}: {count} of 40 frames could be read" in capsys.readouterr().err


def test_the_log_of_a_video_states_frames_and_encoding(tmp_path):
    (record,) = log.summarise(convert(write_video(tmp_path / "drive.mp4"), *FOV)).metadata
    values = dict(record.values)
    assert (values["frames"], values["encoding.image"]) == ("12", "FMP4, stored as jpeg 95")
    assert str(tmp_path) not in json.dumps(values)


def test_images_of_another_sensor_are_not_taken_for_the_camera(tmp_path, capsys):
    jpeg(tmp_path / "shots" / "depth_rear" / "1.jpg", camera_pixels())
    assert "no sensor found" in failure(capsys, tmp_path / "shots", tmp_path / "out.mcap", *FOV)


def test_a_height_and_a_mounting_contradict_each_other(tmp_path, capsys):
    jpeg(tmp_path / "shots" / "1.jpg", camera_pixels())
    document(tmp_path / "shots" / "calibration.json", {"fov_deg": 90, "mounting": {"rgb": {"z": 1.4}}})
    assert "remove --height" in failure(capsys, tmp_path / "shots", tmp_path / "out.mcap", "--height", "1.3")
