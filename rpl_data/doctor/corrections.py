"""Find faults of poses, depth unit and intrinsics by trying the correction of each known fault.

A correction becomes a finding when the depth images agree best under it, and much better than as recorded,
also in resamples of the image pairs. The search then goes on from the corrected geometry, so that two
faults are found one after the other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from jaxtyping import Float64

from rpl_data.doctor.consistency import ComparedImages, Geometry, differences
from rpl_data.doctor.findings import Finding, Kind, option
from rpl_data.recordings.mend import Mend, in_recipe, mended_poses
from rpl_data.wording import counted

MUCH_BETTER_SHARE = 0.7
"""A correction must reduce the differences of depth to this share of what they were."""

BETTER_SHARE, LEAST_FACTOR = 0.95, 1.1
"""For a focal length, this smaller gain is enough when the best one surely differs by at least this factor:
the rest is depth noise, which does not move the optimum. Calibrations are right to 1 %."""

SURE = 0.9
"""Share of resamples in which a correction must pass."""

RAY_SHARE = 0.9
"""Depth along the ray has no factor that could be fitted to noise, and makes a sound recording worse by half;
this gain is enough for it."""

FEWEST_PAIRS = 5

LAGS = tuple(lag for lag in range(-5, 6) if lag)
DEPTH_FACTORS = tuple(float(factor) for factor in np.geomspace(0.1, 10.0, 26) if abs(factor - 1) > 0.15)
"""In steps of 20 %: depth that is farther off disagrees as much as depth can, and leads nowhere."""

USUAL_FACTORS = (0.1, 0.2, 0.25, 0.4, 2.5, 4.0, 5.0, 10.0)
"""Between depth units in use: 1, 1/4, 1/5 and 1/10 mm."""

UNIT_FACTORS = (*USUAL_FACTORS, 0.125, 0.5, 2.0, 8.0)
"""Factors that a unit of depth explains: also 1/8 mm, SUN3D's turned bits and half millimetres."""

NEAR_FACTOR = 1.04
"""A factor this close to a usual one is that: poses and intrinsics are seldom better."""

CLEARLY_BETTER = 0.9
"""The differences of depth under the best correction, as a share of those under the next of another kind:
above it, the two cannot be told apart."""

FOCAL_FACTORS = (0.5, 0.6, 0.7, 0.8, 0.87, 0.93, 1.07, 1.15, 1.25, 1.4, 1.7, 2.0)
SIZE_FACTORS = (1 / 3, 0.5, 2 / 3, 0.75, 4 / 3, 1.5, 2.0, 3.0)


@dataclass(frozen=True)
class Correction:
    """A possible fault and its correction.

    Attributes:
        kind: the kind of fault.
        what: description of the fault.
        todo: advice on how to mend it.
        geometry: the corrected geometry.
        mend: the recipe option that corrects it, where there is one.
        sure: for a factor, share of resamples that find it farther from 1 than `LEAST_FACTOR`.
        enough: share of the differences of depth that may remain under it.
    """

    kind: Kind
    what: str
    todo: str
    geometry: Geometry
    mend: Mend | None = None
    sure: float = 0.0
    enough: float = MUCH_BETTER_SHARE


def faults(compared: ComparedImages, geometry: Geometry, *, most: int = 3) -> tuple[list[Finding], Geometry]:
    """Find what is wrong with the geometry of a recording, the worst fault first; and what corrects it all.

    The search ends where a kind of fault would be named twice: what one factor leaves is no second factor.
    """
    findings: list[Finding] = []
    now = differences(compared, geometry)
    while len(findings) < most:
        tried = [(found, differences(compared, found.geometry)) for found in _corrections(compared, geometry)]
        best, then = min(tried, key=lambda pair: _mean(now, pair[1]))
        sure = max(_sure(now, then, best.enough), min(best.sure, _sure(now, then, BETTER_SHARE)))
        if sure < SURE or best.kind in {finding.kind for finding in findings}:
            break
        share = f"depth images then agree {_mean(now, now) / _mean(now, then):.1f} times better"
        others = [pair for pair in tried if pair[0].kind != best.kind]
        next_best, otherwise = min(others, key=lambda pair: _mean(now, pair[1]))
        clear = _sure(otherwise, then, CLEARLY_BETTER)
        todo = best.todo
        if clear < SURE:
            todo += f"; hardly worse: {next_best.what}, and then {next_best.todo}"
        findings.append(Finding(best.kind, f"{best.what} ({share})", min(sure, clear), todo, best.mend))
        geometry, now = best.geometry, then
    return findings, geometry


def _mean(now: Float64[np.ndarray, " pairs"], then: Float64[np.ndarray, " pairs"]) -> float:
    """Mean of `then` over pairs judged both times; infinite if they are less than half of those in `now`."""
    both = np.isfinite(now) & np.isfinite(then)
    return float(then[both].mean()) if 2 * both.sum() > np.isfinite(now).sum() else float("inf")


def _sure(now: Float64[np.ndarray, " pairs"], then: Float64[np.ndarray, " pairs"], share: float) -> float:
    """Share of bootstrap resamples of the pairs in which `then` averages below `share` times `now`."""
    both = np.isfinite(now) & np.isfinite(then)
    if both.sum() < FEWEST_PAIRS:
        return 0.0
    means_now, means_then = _resampled_means(np.stack([now[both], then[both]]))
    return float((means_then < share * means_now).mean())


def _resampled_means(
    values: Float64[np.ndarray, "rows pairs"], *, resamples: int = 200
) -> Float64[np.ndarray, "rows resamples"]:
    """Means of each row, over the same resamples of the pairs for all rows."""
    count = values.shape[1]
    chosen = np.random.default_rng(0).choice(count, (resamples, count))
    means: Float64[np.ndarray, "rows resamples"] = values[:, chosen].mean(axis=2)
    return means


def _corrections(compared: ComparedImages, geometry: Geometry) -> Iterator[Correction]:
    yield from _readings(geometry)
    yield from _pose_lags(compared, geometry)
    yield _best_factor(compared, DEPTH_FACTORS, lambda factor: _other_depth_unit(geometry, factor))
    yield _best_factor(
        compared, FOCAL_FACTORS, lambda factor: _other_focal_length(geometry, factor), with_sureness=True
    )
    yield from (_other_size(geometry, factor) for factor in SIZE_FACTORS)
    if not geometry.along_ray:
        yield _along_ray(geometry)


def _readings(geometry: Geometry) -> Iterator[Correction]:
    """The seven other ways to read poses: quaternion order x direction x camera axes."""
    for wxyz, inverted, opengl in list(product((False, True), repeat=3))[1:]:
        mend = Mend(wxyz_quaternions=wxyz, inverted_poses=inverted, opengl_cameras=opengl)
        said = {
            "their quaternions are w x y z": wxyz,
            "they are camera_from_scene": inverted,
            "their cameras look along -z with y up (OpenGL)": opengl,
        }
        convention = ", ".join(text for text, true in said.items() if true)
        what = f"the poses are stored in another convention: {convention}"
        poses = mended_poses(geometry.scene_from_camera, mend)
        read = replace(geometry, scene_from_camera=poses)
        yield Correction("pose convention", what, option(mend), read, mend)


def _pose_lags(compared: ComparedImages, geometry: Geometry) -> Iterator[Correction]:
    for lag in LAGS:
        poses = shifted(geometry.scene_from_camera, compared.runs, lag)
        what = f"poses belong to images {counted(abs(lag), 'frame')} {'earlier' if lag > 0 else 'later'}"
        mend = Mend(pose_lag=lag)
        paired = replace(geometry, scene_from_camera=poses)
        yield Correction("pose lag", what, option(mend), paired, mend)


def shifted(
    poses: Float64[np.ndarray, "n 4 4"], runs: Sequence[tuple[int, int]], lag: int
) -> Float64[np.ndarray, "n 4 4"]:
    """Give every image the pose of the image `lag` places later in its run; NaN at the ends."""
    result = np.full_like(poses, np.nan)
    for first, behind in runs:
        for row in range(max(first, first - lag), min(behind, behind - lag)):
            result[row] = poses[row + lag]
    return result


def _best_factor(
    compared: ComparedImages,
    factors: Sequence[float],
    corrected: Callable[[float], Correction],
    *,
    with_sureness: bool = False,
) -> Correction:
    """Find the best correction of a family with one factor, on a coarse, a finer and a fine grid."""
    tried: dict[float, Float64[np.ndarray, " pairs"]] = {}
    grid = [1.0, *factors]
    for step in (0.04, 0.01, 0.0):
        tried |= {
            factor: differences(compared, corrected(factor).geometry)
            for factor in grid
            if factor not in tried
        }
        best = min(tried, key=lambda factor: np.nanmean(tried[factor]) if factor != 1 else np.inf)
        grid = [best * float(np.exp(step * n)) for n in range(-3, 4)]
    found = corrected(best)
    return replace(found, sure=_sure_of_factor(tried)) if with_sureness else found


def _sure_of_factor(tried: Mapping[float, Float64[np.ndarray, " pairs"]]) -> float:
    """Share of resamples whose best factor is farther from 1 than `LEAST_FACTOR`."""
    values = np.stack(list(tried.values()))
    judged = np.isfinite(values).all(axis=0)
    if judged.sum() < FEWEST_PAIRS:
        return 0.0
    best = np.array(list(tried))[_resampled_means(values[:, judged]).argmin(axis=0)]
    return float((np.abs(np.log(best)) > np.log(LEAST_FACTOR)).mean())


def _other_depth_unit(geometry: Geometry, factor: float) -> Correction:
    what = f"depths are {_times(factor)} what the poses say"
    mend = Mend(depth_factor=usual_factor(factor))
    fitting = replace(geometry, metres_factor=geometry.metres_factor * factor)
    unit = f"{option(mend)}, or metres_per_unit {mend.depth_factor:g} times what it is"
    if mend.depth_factor in UNIT_FACTORS:
        return Correction("depth scale", what, unit, fitting, mend)
    poses = in_recipe(Mend(pose_factor=float(f"{1 / factor:.3g}")))
    todo = (
        "find out which of the two is in metres, since no usual unit of depth explains it: where depth "
        f"is, as with poses of COLMAP or a tool that knows no metres, `{poses}`; where the poses are, {unit}"
    )
    return Correction("depth scale", what, todo, fitting)


def usual_factor(factor: float) -> float:
    """The factor between two depth units in use that is meant, else the measured one to three digits."""
    nearest = min(UNIT_FACTORS, key=lambda usual: abs(np.log(factor / usual)))
    return nearest if abs(np.log(factor / nearest)) < np.log(NEAR_FACTOR) else float(f"{factor:.3g}")


def _along_ray(geometry: Geometry) -> Correction:
    what = "depth is the distance along each pixel's ray, not along the optical axis, as in some simulators"
    mend = Mend(depth_along_ray=True)
    corrected = replace(geometry, along_ray=True)
    return Correction("ray length", what, option(mend), corrected, mend, enough=RAY_SHARE)


def _other_focal_length(geometry: Geometry, factor: float) -> Correction:
    camera = geometry.intrinsics
    fitting = replace(camera, fx=camera.fx * factor, fy=camera.fy * factor)
    what = f"the focal length {camera.fx:.0f} px does not fit; about {fitting.fx:.0f} px would"
    todo = (
        "ask the camera's own tool for the intrinsics of these images, and give the scenes "
        "`camera: [fx, fy, cx, cy]` in the recipe"
    )
    return Correction("intrinsics", what, todo, replace(geometry, intrinsics=fitting))


def _other_size(geometry: Geometry, factor: float) -> Correction:
    camera = geometry.intrinsics
    fx, fy, cx, cy = (factor * value for value in (camera.fx, camera.fy, camera.cx, camera.cy))
    what = f"the intrinsics are those of images {1 / factor:.2f} times this size"
    todo = f"in the recipe, give these scenes about `camera: [{fx:.0f}, {fy:.0f}, {cx:.0f}, {cy:.0f}]`"
    fitting = replace(camera, fx=fx, fy=fy, cx=cx, cy=cy)
    return Correction("intrinsics", what, todo, replace(geometry, intrinsics=fitting))


def _times(factor: float) -> str:
    return f"{1 / factor:.2f} times" if factor < 1 else f"1/{factor:.2f} of"
