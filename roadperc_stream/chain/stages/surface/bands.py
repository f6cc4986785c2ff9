"""Equations in which only neighbouring unknowns stand together: their matrix as a band of diagonals."""

import numpy as np

from roadperc_stream.core.geometry import Float


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
