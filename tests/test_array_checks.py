"""Types, shapes and named axes of arrays are checked on every call of `rpl_data` in the tests."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from array_checks import checked
from beartype.roar import BeartypeCallHintViolation
from jaxtyping import Float64

from rpl_data.geometry import fit_rigid, rays, transform


@pytest.mark.parametrize(
    "call",
    [
        lambda: transform(np.eye(3), np.zeros((5, 3))),
        lambda: transform(np.eye(4), np.zeros((5, 3), np.float32)),
        lambda: fit_rigid(np.zeros((4, 3)), np.zeros((5, 3))),
        lambda: rays("a camera", np.zeros((5, 2))),
    ],
    ids=["size", "kind of number", "axes of one name", "class"],
)
def test_wrong_arguments_are_refused(call: Callable[[], Any]) -> None:
    with pytest.raises(BeartypeCallHintViolation):
        call()


def test_wrong_results_are_refused_and_axes_of_an_earlier_call_are_forgotten() -> None:
    @checked(typechecker=None)
    def first(points: Float64[np.ndarray, "n 3"], count: int) -> Float64[np.ndarray, " n"]:
        return points[:count, 0]

    assert first(np.zeros((4, 3)), 4).shape == (4,) and first(np.zeros((2, 3)), 2).shape == (2,)
    with pytest.raises(BeartypeCallHintViolation):
        first(np.zeros((4, 3)), 3)
