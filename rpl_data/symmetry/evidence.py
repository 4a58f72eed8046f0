"""How well motions bring an object's surface and its print onto themselves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.spatial import cKDTree

from rpl_data.geometry import Points, Transform, transform
from rpl_data.symmetry.samples import Samples

NORMAL_M = 0.01
"""Partners whose unit normals differ by 1 (60 degrees) count as this much farther apart, so that the inside
of a wall is not taken for its outside."""
NEIGHBOURS = 8
"""Samples around a point among which the partner of its colour is looked for: a print may be slightly off."""
COARSE_TARGET = 4000
"""Samples of the target that the search over all directions uses."""
SAME_PRINT = 0.25
"""Largest difference of two prints that count as the same: about a quarter of their lightness or colour."""


@dataclass(frozen=True)
class Fit:
    """How well a surface fits itself after a motion, over the parts that were seen at both places.

    Attributes:
        compared: share of the surface's area that was compared.
        off_m: 95th percentile of the distance between the moved surface and the surface, metres.
        shape_off: share of the compared points farther off than the tolerance.
        print_off: share of the compared points whose colour differs; NaN without colours.
    """

    compared: float
    off_m: float
    shape_off: float
    print_off: float


@dataclass(frozen=True)
class Matcher:
    """A surface, indexed to find the partner of every moved point.

    Attributes:
        target: the dense samples that partners are taken from.
        probe: the samples that are moved.
        tree: index over places and normals of the target.
        coarse: index over the places of some of it.
    """

    target: Samples
    probe: Samples
    tree: cKDTree
    coarse: cKDTree

    @staticmethod
    def of(target: Samples, probe: Samples) -> Matcher:
        """Index the target."""
        fine = cKDTree(_features(target.points, target.normals))
        return Matcher(target, probe, fine, cKDTree(target.points[:COARSE_TARGET]))

    def coarse_distance_m(self, motion: Transform, *, probes: int, cap_m: float) -> float:
        """Mean distance of the first moved points to the surface; one farther off counts as `cap_m`."""
        moved = transform(motion, self.probe.points[:probes])
        return float(np.minimum(self.coarse.query(moved, distance_upper_bound=cap_m)[0], cap_m).mean())

    def partners(
        self, motion: Transform, rows: slice | Bool[np.ndarray, " n"], count: int = 1
    ) -> tuple[Points, Points, np.ndarray]:
        """Move some of the probe; returns its points, normals, and the numbers of their partners."""
        points = transform(motion, self.probe.points[rows])
        normals = self.probe.normals[rows] @ motion[:3, :3].T
        return points, normals, self.tree.query(_features(points, normals), k=count)[1]

    def distances(self, points: Points, partners: np.ndarray) -> Float64[np.ndarray, " n"]:
        """Distance of moved points to the planes of their partners; to the partner, where that is far."""
        offset = points - self.target.points[partners]
        to_plane = np.abs((offset * self.target.normals[partners]).sum(axis=1))
        beside = np.linalg.norm(offset, axis=1)
        found: Float64[np.ndarray, " n"] = np.where(beside > 0.008, beside, to_plane)
        return found

    def fit(self, motion: Transform, *, tolerance_m: float) -> Fit:
        """Compare shape and print after one motion."""
        points, normals, near = self.partners(motion, slice(None), NEIGHBOURS)
        both = self.probe.seen & self.target.seen[near[:, 0]]
        if both.sum() < 10:
            return Fit(float(both.mean()), np.nan, np.nan, np.nan)
        far = self.distances(points[both], near[both, 0])
        return Fit(
            compared=float(both.mean()),
            off_m=float(np.percentile(far, 95)),
            shape_off=float((far > tolerance_m).mean()),
            print_off=self._print_off(normals[both], near[both], both),
        )

    def _print_off(
        self, normals: Points, near: Int64[np.ndarray, "n k"], both: Bool[np.ndarray, " m"]
    ) -> float:
        """Share of points whose print differs from all prints near their partner.

        Light and shade go with the normal: what a smooth function of it explains of the differences in
        lightness is no print (second-order harmonics: Basri and Jacobs, PAMI 25, 2003).
        """
        if self.probe.print is None or self.target.print is None:
            return float("nan")
        change = self.target.print[near] - self.probe.print[both][:, None]
        shading = _harmonics(np.column_stack([normals, self.probe.normals[both]]))
        weight = np.ones(len(shading))
        for _ in range(5):  # differences of print are outliers of the shading
            root = np.sqrt(weight)[:, None]
            fitted = np.linalg.lstsq(shading * root, change[:, 0, 0] * root[:, 0], rcond=None)[0]
            left = change[:, 0, 0] - shading @ fitted
            weight = 1 / (1 + (left / SAME_PRINT) ** 2)
        change[..., 0] -= (shading @ fitted)[:, None]
        nearest = np.linalg.norm(change, axis=2).min(axis=1)
        return float((nearest > SAME_PRINT).mean())


def _features(points: Points, normals: Points) -> Float64[np.ndarray, "n 6"]:
    return np.column_stack([points, NORMAL_M * normals])


def _harmonics(normals: Float64[np.ndarray, "n 6"]) -> Float64[np.ndarray, "n m"]:
    """Real spherical harmonics up to the second order, of the normal before and of that after."""
    columns = [np.ones(len(normals))]
    for x, y, z in (normals[:, :3].T, normals[:, 3:].T):
        columns += [x, y, z, x * y, y * z, z * x, x * x - y * y, 3 * z * z - 1]
    return np.stack(columns, axis=1)
