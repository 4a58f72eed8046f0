"""The one error that the user can mend."""

from __future__ import annotations


class DataError(ValueError):
    """An error that the user can mend.

    The message says what is wrong, where, what was expected, what was found and what to do.
    """
