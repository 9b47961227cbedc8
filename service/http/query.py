"""Reads shape coefficients from the query of a request."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from fastapi import Query

from drape.body.model import BodyModel
from drape.errors import InputError
from drape.stages.batch import shape_array

Betas = Annotated[
    str | None, Query(max_length=1000, description="The shape coefficients, separated by commas. Zeros if left out.")
]


def queried_shape(text: str | None, body: BodyModel) -> np.ndarray:
    """Returns the shape coefficients (S,) of ``body`` in ``text``, numbers between commas; zeros for those that are
    left out. Refuses (``InputError``, ``BodyError``) text that is no shape of the body."""
    try:
        numbers = [float(part) for part in text.split(",")] if text else []
    except ValueError as error:
        raise InputError(
            "betas", expected="comma-separated numbers", got=str(text)[:60], cure="For example ?betas=0.5,-1."
        ) from error
    return shape_array(numbers, body)
