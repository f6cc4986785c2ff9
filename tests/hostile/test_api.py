"""Invalid arguments of the Python API raise an error at the call."""

import numpy as np
import pytest

import roadperc_stream as rp
from roadperc_stream.errors import ChannelError, ConfigError
from roadperc_stream.geometry import Camera
from tests import logs

CAMERA = Camera("camera", 64, 48, 40.0, 40.0, 31.5, 23.5)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return logs.write(tmp_path_factory.mktemp("api") / "in.mcap", logs.items(1))


def test_an_unknown_role_is_named(log, tmp_path):
    with pytest.raises(ChannelError, match="no role 'imge'; roles: image"):
        next(rp.frames(log, topics={"imge": "/camera/front/image"}))
    with pytest.raises(ChannelError, match="no role 'imge'"):
        rp.replay(log, tmp_path / "out.mcap", topics={"imge": "/camera/front/image"})


@pytest.mark.parametrize(
    ("option", "words"),
    [*(({"max_frames": count}, "frames: expected a whole number") for count in (1.5, "2", True, np.float64(2.0))),
     ({"start_s": "1"}, "start: expected seconds, found '1'")],
)  # fmt: skip
def test_an_option_of_a_wrong_type_is_named(log, option, words):
    with pytest.raises(ConfigError, match=words):
        next(rp.frames(log, **option))


def test_numpy_integers_are_accepted(log):
    assert len(list(rp.frames(log, max_frames=np.int64(1)))) == 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda pose: pose.__setitem__((0, 0), 2.0), "expected a rotation"),
        (lambda pose: pose.__setitem__(slice(0, 3), -pose[:3]), "expected a rotation"),
        (lambda pose: pose.__setitem__((3, 0), 1.0), "last row"),
        (lambda pose: pose.__setitem__((slice(0, 3), slice(0, 3)), 0.0), "expected a rotation"),
    ],
    ids=["scaled", "mirrored", "projective", "flat"],
)
def test_a_mounting_that_is_no_rigid_transform_is_refused(change, words):
    pose = np.array([[0, 0, 1, 2], [-1, 0, 0, 0], [0, -1, 0, 1.5], [0, 0, 0, 1]], float)
    rp.Chain(CAMERA, ego_T_camera=pose)
    change(pose)
    with pytest.raises(ValueError, match=words):
        rp.Chain(CAMERA, ego_T_camera=pose)


@pytest.mark.parametrize("kind", [np.int64, np.uint16, np.int8, np.float32, bool, object])
def test_an_image_of_another_type_is_refused(kind):
    """Although its values are 0 to 255; those of 12 or 16 bits can be dark."""
    with pytest.raises(ValueError, match="image: expected uint8, found"):
        rp.Chain(CAMERA).step(0, image=np.ones((48, 64, 3), kind))
