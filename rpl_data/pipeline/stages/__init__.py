"""The stages of a build, one module per command: each plans its steps and runs them."""

from itertools import chain

TOGETHER = (
    ("twin",),
    ("import",),
    ("clicks",),
    ("track", "drift", "cut"),
    ("solve",),
    ("surface", "refine", "segment", "label"),
    ("export", "quality", "report"),
)
"""Stages that can be planned at once: planning one needs results of earlier groups alone."""

ORDER = tuple(chain.from_iterable(TOGETHER))
"""Their names, in the order they run."""
