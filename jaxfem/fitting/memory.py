"""How much memory one simulation with derivatives takes, and how to keep below a limit.

Of a run only the markers' places are held, so that its length costs next to nothing; what counts is how many columns of
the Jacobian are made side by side, each with a body's state and matrices. XLA says how much its program takes.
"""

import dataclasses
from typing import Any

import numpy as np

from jaxfem.fitting.errors import FitError
from jaxfem.fitting.evaluation import Evaluator, Piece
from jaxfem.fitting.objective import linearised

GIGA = 1e9


def limit_memory(evaluator: Evaluator, most: float | None) -> None:
    """Have the evaluator make as many columns at a time as `most` [GB] allows, all of them where it is None.

    FitError for what is no size, or where one column alone takes more.
    """
    if most is None:
        return
    if isinstance(most, bool) or not isinstance(most, int | float) or not most > 0:
        raise FitError(f"max_memory is {most!r}: give a size in GB, like 1.0")
    evaluator.pieces = tuple(_within(piece, most * GIGA) for piece in evaluator.pieces)


def _within(piece: Piece, most: float) -> Piece:
    """The piece with as many columns at a time as fit."""
    count = columns = max(1, len(piece.columns))
    while True:
        tried = piece if columns == count else _by(piece, columns)
        needed = bytes_of(tried)
        if needed <= most:
            return tried
        if columns == 1:
            raise FitError(
                f"one simulation with one derivative takes {needed / GIGA:.2g} GB, more than max_memory = "
                f"{most / GIGA:g}: take a coarser mesh, fewer bodies, or single precision"
            )
        columns = (columns + 1) // 2


def _by(piece: Piece, columns: int) -> Piece:
    return dataclasses.replace(piece, plan=dataclasses.replace(piece.plan, at_once=columns))


def bytes_of(piece: Piece) -> float:
    """Bytes that the program of a simulation with derivatives takes beside its arguments."""
    z = piece.at(np.zeros(int(piece.columns.max(initial=-1)) + 1))
    analysis: Any = linearised.lower(z, piece.problem, piece.plan).compile().memory_analysis()
    return float(analysis.temp_size_in_bytes + analysis.output_size_in_bytes) if analysis is not None else 0.0
