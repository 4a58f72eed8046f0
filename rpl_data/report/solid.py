"""The 3D figure of an object: dense mesh and named keypoints, turned with the mouse."""

from __future__ import annotations

from typing import Any

import numpy as np

from rpl_data.meshes import simplified
from rpl_data.overlay import keypoint_color
from rpl_data.types import KeypointModel, Mesh

MOST_TRIANGLES = 20_000
"""Enough to see the shape; more would only make the page large."""
BACKGROUND = "#20262b"
"""Dark on a light page, too, so that names are legible both beside and in front of the object."""
INK = "#f4f6f7"
LINES = "#87919a"


def solid(model: KeypointModel, mesh: Mesh | None, *, with_library: bool) -> str:
    """Make a div with the figure.

    Args:
        with_library: include plotly.js itself, which one figure of the page must do.
    """
    import plotly.graph_objects as go

    traces: list[Any] = [] if mesh is None else [_surface(simplified(mesh, most_triangles=MOST_TRIANGLES))]
    traces += [*_skeleton(model), _keypoints(model)]
    axis = {
        "title": "",
        "color": INK,
        "gridcolor": "rgba(138,148,156,.25)",
        "showbackground": False,
        "zeroline": False,
    }
    figure = go.Figure(traces)
    figure.update_layout(
        height=430,
        margin={"l": 0, "r": 0, "t": 0, "b": 0},
        paper_bgcolor=BACKGROUND,
        font={"color": INK, "size": 11},
        showlegend=False,
        scene={
            "aspectmode": "data",
            **{f"{name}axis": axis | {"ticksuffix": " mm", "nticks": 4} for name in "xyz"},
        },
    )
    page: str = figure.to_html(
        full_html=False,
        include_plotlyjs=with_library,
        config={"displaylogo": False, "responsive": True, "displayModeBar": False},
    )
    return f'<div class="solid">{page}</div>'


def _surface(mesh: Mesh) -> Any:
    import plotly.graph_objects as go

    vertices = (1e3 * mesh.vertices).astype(np.float32)
    a, b, c = (mesh.triangles[:, i].astype(np.int32) for i in range(3))
    colors = {"color": "#8d979d", "flatshading": len(mesh.triangles) < 100}
    if mesh.colors is not None:
        colors = {"vertexcolor": [f"rgb({r},{g},{b})" for r, g, b in mesh.colors]}
    light = {"ambient": 0.6, "diffuse": 0.6, "specular": 0.1, "roughness": 0.8}
    x, y, z = vertices.T
    return go.Mesh3d(x=x, y=y, z=z, i=a, j=b, k=c, lighting=light, hoverinfo="skip", **colors)


def _skeleton(model: KeypointModel) -> list[Any]:
    import plotly.graph_objects as go

    known = model.known
    lines = []
    for a, b in model.skeleton:
        if known[a] and known[b]:
            x, y, z = 1e3 * model.points_object[[a, b]].T
            lines.append(
                go.Scatter3d(x=x, y=y, z=z, mode="lines", line={"color": LINES, "width": 3}, hoverinfo="skip")
            )
    return lines


def _keypoints(model: KeypointModel) -> Any:
    import plotly.graph_objects as go

    numbers = np.flatnonzero(model.known)
    x, y, z = 1e3 * model.points_object[numbers].T
    colors = [keypoint_color(int(k), len(model.keypoints)) for k in numbers]
    return go.Scatter3d(
        x=x,
        y=y,
        z=z,
        mode="markers+text",
        text=[_label(int(k), model.keypoints[k]) for k in numbers],
        textposition="top center",
        textfont={"color": INK, "size": 13},
        marker={"size": 6, "color": [f"rgb{rgb}" for rgb in colors], "line": {"color": "#222", "width": 1}},
        hovertemplate="%{text}<br>%{x:.1f}, %{y:.1f}, %{z:.1f} mm<extra></extra>",
    )


def _label(keypoint: int, name: str) -> str:
    """Number and name of a keypoint; escaped, since plotly interprets some tags in texts."""
    safe = name.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return safe if name == str(keypoint) else f"{keypoint} {safe}"
