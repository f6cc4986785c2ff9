"""Cubic B-splines on evenly spaced knots, and the banded equations of their coefficients."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Float

DEGREE: Final = 3


def band_of(lower: Float) -> Float:
    """(2 D - 1, P) band of a symmetric (P, P) matrix from the (D, P) diagonals in and below its middle.

    Row r holds the elements of the diagonal r - D + 1 below the middle, each at its column.
    """
    diagonals, columns = lower.shape
    band = np.zeros((2 * diagonals - 1, columns))
    band[diagonals - 1 :] = lower
    for beside in range(1, diagonals):
        band[diagonals - 1 - beside, beside:] = lower[beside, :-beside]
    return band


def solved(band: Float, right: Float, otherwise: Float) -> Float:
    """(P,) solution of equations given as a (2 D - 1, P) band, by LU decomposition; ``otherwise`` where there is none.

    LAPACK itself: what scipy's ``solve_banded`` does before it calls the same function takes longer than all the rest.
    """
    from scipy.linalg.lapack import dgbsv

    beside = len(band) // 2
    workspace = np.zeros((len(band) + beside, band.shape[1]), order="F")
    workspace[beside:] = band
    _, _, solution, fault = dgbsv(beside, beside, workspace, right, overwrite_ab=True)
    return otherwise if fault else np.asarray(solution, float)


def basis(knot_m: float, splines: int, x: Float) -> tuple[NDArray[np.intp], Float]:
    """The four B-splines that are not 0 at a place: the (N,) index of the first, and their (N, 4) values.

    By the recurrence of de Boor and Cox from degree 0 on (de Boor 1978), as scipy's ``BSpline.design_matrix`` has it,
    whose import takes half a second.

    Args:
        knot_m: distance of the knots.
        splines: how many there are.
        x: (N,) from 0 to the last knot but three.
    """
    knots = knot_m * np.arange(-DEGREE, splines + 1)
    left = np.clip(np.searchsorted(knots, x, side="right") - 1, DEGREE, splines - 1)
    values = [np.ones(len(x))]
    for degree in range(1, DEGREE + 1):
        raised = [np.zeros(len(x)) for _ in range(degree + 1)]
        for k, value in enumerate(values, start=1):
            before, after = knots[left + k - degree], knots[left + k]
            share = value / (after - before)
            raised[k - 1] += share * (after - x)
            raised[k] = share * (x - before)
        values = raised
    return left - DEGREE, np.stack(values, axis=-1)
