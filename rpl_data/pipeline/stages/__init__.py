"""The stages of a build, one module per command: each plans its steps and runs them."""

ORDER = (
    "twin",
    "import",
    "clicks",
    "track",
    "drift",
    "cut",
    "solve",
    "surface",
    "refine",
    "segment",
    "label",
    "export",
    "quality",
    "report",
)
"""Their names, in the order they run."""
