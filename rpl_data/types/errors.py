"""The one error that the user can mend, and its kind that one click mends."""

from __future__ import annotations


class DataError(ValueError):
    """An error that the user can mend.

    The message says what is wrong, where, what was expected, what was found and what to do.
    """


class UnsureError(DataError):
    """What was asked for was not found surely enough to be written down.

    The message names the click that would tell.

    Attributes:
        frame, keypoint: where that click is; None where no single click would tell.
    """

    def __init__(self, message: str, *, frame: int | None = None, keypoint: int | None = None) -> None:
        super().__init__(message)
        self.frame, self.keypoint = frame, keypoint
