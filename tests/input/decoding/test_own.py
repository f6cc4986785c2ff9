"""The project's own messages as others may write them: a road's heights have a grid, or there is an error."""

import numpy as np
import pytest

from roadperc_stream.errors import DecodeError
from roadperc_stream.input.decoding import Context, decode
from roadperc_stream.schemas import roadperc_pb2 as pb

STAMP = 1_600_000_000_000_000_000


def surface(**grid):
    known = {"x_min_m": 2.0, "y_min_m": -1.0, "step_m": 0.5, "rows": 2, "columns": 3, "z_m": range(6)}
    message = pb.Surface(camera_height_m=1.5, height_grid=pb.HeightGrid(**known | grid))
    message.normal.y = -1.0
    return decode("surface", "roadperc.Surface", "protobuf", message.SerializeToString(), STAMP, Context()).payload


def test_a_height_grid_comes_back():
    grid = surface().height_grid
    assert (grid.x_min_m, grid.y_min_m, grid.step_m) == (2.0, -1.0, 0.5)
    np.testing.assert_array_equal(grid.z_m, [[0, 1, 2], [3, 4, 5]])


@pytest.mark.parametrize(
    ("grid", "words"),
    [
        ({"rows": 1, "columns": 6}, "1 rows of 6, 6 heights"),
        ({"rows": 6, "columns": 1}, "6 rows of 1, 6 heights"),
        ({"rows": 0, "columns": 0, "z_m": []}, "0 rows of 0, 0 heights"),
        ({"z_m": range(5)}, "2 rows of 3, 5 heights"),
        ({"rows": 2**32 - 1, "columns": 2**32 - 1}, "6 heights"),
        ({"step_m": 0.0}, "in steps of 0 m"),
        ({"step_m": -0.5}, "in steps of -0.5 m"),
        ({"step_m": np.nan}, "not finite"),
        ({"x_min_m": np.inf}, "not finite"),
        ({"y_min_m": -np.inf}, "not finite"),
        ({"z_m": [0, 1, 2, 3, 4, np.nan]}, "not finite"),
        ({"x_min_m": 1e30}, r"1e\+30 m, in steps of 0.5 m"),
        ({"step_m": 1e300}, "not finite in 32 bits"),
    ],
    ids=str,
)
def test_a_height_grid_that_is_none_is_refused(grid, words):
    with pytest.raises(DecodeError, match=f"height grid: .*{words}"):
        surface(**grid)


def test_a_normal_beyond_any_is_refused_without_a_warning():
    message = pb.Surface(normal=pb.Vector3(z=-1e308))
    with pytest.raises(DecodeError, match="surface: a number is not finite in 32 bits"):
        decode("surface", "roadperc.Surface", "protobuf", message.SerializeToString(), STAMP, Context())
