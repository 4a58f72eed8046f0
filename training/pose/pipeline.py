"""Detector, hourglass and PnP in a row: from an image to the poses of its objects (paper, section IV-C)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch

from rpl_data.geometry import depth_sigma_m
from rpl_data.pose import correspondences
from rpl_data.pose.depth import depths_at
from rpl_data.pose.estimate import Method, PoseEstimate, PoseFailure, estimate_pose
from rpl_data.torch.image_files import to_unit_range
from rpl_data.torch.transforms import crop_from_square, warped
from rpl_data.types import DataError, DepthImage, Intrinsics

from ..detection.module import Detection, DetectorTraining, load_detector
from ..keypoints.module import KeypointTraining, load_keypoints

WEIGHING: tuple[Method, ...] = ("ransac", "consensus")
"""Methods that leave outliers out, weight the rest and use depth; the others are as in the paper."""

LEAST_CONFIDENCE = 0.1
"""Keypoints below this confidence are not used; the others are weighted by their covariance."""


@dataclass(frozen=True)
class SeenKeypoints:
    """The k keypoints that the hourglass found on one object, in pixels of the full image.

    Attributes:
        object: its name.
        square_px: centre and side of the crop: cx, cy, side.
        score: score of the detection; 1 where the crop was given.
        positions_px: (u, v) of each keypoint, k x 2.
        confidence: one number from 0 to 1 per keypoint.
        covariance_px: one 2 x 2 covariance per position, k x 2 x 2, in px^2.
    """

    object: str
    square_px: np.ndarray
    score: float
    positions_px: np.ndarray
    confidence: np.ndarray
    covariance_px: np.ndarray


@dataclass(frozen=True)
class PosePipeline:
    """The trained networks that together estimate poses.

    Attributes:
        networks: one hourglass per object, by the object's name.
        detector: finds the crops; None where crops are given.
    """

    networks: Mapping[str, KeypointTraining]
    detector: DetectorTraining | None = None

    def see(
        self, image: np.ndarray, squares_px: Mapping[str, np.ndarray] | None = None
    ) -> list[SeenKeypoints]:
        """Find the keypoints of the objects in an RGB image.

        Args:
            image: height x width x 3, uint8.
            squares_px: cx, cy, side of each crop, by its object's name; detected when left out.
        """
        if squares_px is not None:
            found = {name: Detection(np.asarray(square), 1.0) for name, square in squares_px.items()}
        elif self.detector is not None:
            found = self.detector.detect(image)
        else:
            unknown = "nothing says where the objects are in the images"
            raise DataError(f"{unknown}; give --detector, a checkpoint of `rpl train detector`")
        return [
            _keypoints(self.networks[name], image, detection)
            for name, detection in found.items()
            if name in self.networks
        ]

    def pose(
        self,
        seen: SeenKeypoints,
        intrinsics: Intrinsics,
        *,
        method: Method = "consensus",
        depth: DepthImage | None = None,
    ) -> PoseEstimate | PoseFailure:
        """Estimate ``camera_from_object``, in the object frame that the network was trained with.

        Args:
            seen: what `see` found.
            intrinsics: the camera of the full image.
            method: `epnp` and `sqpnp` use every keypoint and are not refined, as in the paper; the others
                leave outliers out and weight the rest by their covariance.
            depth: a depth image registered to the colour image; it fixes the distance.
        """
        used = np.where(seen.confidence[:, None] >= LEAST_CONFIDENCE, seen.positions_px, np.nan)
        depth_m = None if depth is None else depths_at(depth, used)
        sigma_m = None if depth_m is None else _depth_sigma_m(depth_m, seen.covariance_px, intrinsics)
        given = correspondences(
            self.networks[seen.object].model.points_object,
            used,
            intrinsics,
            covariance_px=seen.covariance_px,
            depth_m=depth_m,
            depth_sigma_m=sigma_m,
        )
        return estimate_pose(given, method=method, refine=method in WEIGHING)


KEYPOINT_DEPTH_SIGMA_M = 0.003
"""Joins the sensor's standard deviation: at a corner, the depth may be that of a neighbouring point."""


def read_depth_like(path: Path, metres_per_unit: float, *, like: np.ndarray) -> DepthImage:
    """Read a 16-bit depth image; float32 metres, 0 where there is none.

    Raises:
        DataError: it is missing, broken, or not of the size of the colour image `like`.
    """
    raw = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) if path.exists() else None
    if raw is None or raw.dtype != np.uint16 or raw.shape != like.shape[:2]:
        found = "nothing readable" if raw is None else f"{raw.dtype}, {raw.shape}"
        raise DataError(
            f"{path}: expected a depth image, uint16, {like.shape[:2]}, as large as its colour image, found "
            f"{found}; depth must be registered to colour"
        )
    return raw.astype(np.float32) * np.float32(metres_per_unit)


def load_pipeline(networks: Sequence[Path], detector: Path | None = None) -> PosePipeline:
    """Load the networks of a pipeline.

    Args:
        networks: checkpoints of `train_keypoints`, one per object.
        detector: checkpoint of `train_detector`.

    Raises:
        DataError: there is no network, two are of the same object, or the detector does not know the object
            of one.
    """
    if not networks:
        raise DataError("no keypoint network is named; --keypoints takes a list: '[run/last.ckpt]'")
    loaded = [load_keypoints(path) for path in networks]
    by_name = {network.model.name: network for network in loaded}
    if len(by_name) < len(loaded):
        raise DataError(
            f"two checkpoints are of the same object: {', '.join(str(path) for path in networks)}"
        )
    if detector is None:
        return PosePipeline(by_name)
    pipeline = PosePipeline(by_name, load_detector(detector))
    check_detected(pipeline, str(detector))
    return pipeline


def check_detected(pipeline: PosePipeline, source: str) -> None:
    """Refuse a detector that was not trained on all objects: it would never find the others."""
    known = [] if pipeline.detector is None else pipeline.detector.names[1:]
    unknown = sorted(set(pipeline.networks) - set(known))
    if unknown:
        raise DataError(
            f"{source}: the detector does not know {', '.join(unknown)}, which a keypoint checkpoint is of; "
            f"it knows {', '.join(known)}: leave that checkpoint out, or train a detector on all objects"
        )


@torch.no_grad()
def _keypoints(network: KeypointTraining, image: np.ndarray, detection: Detection) -> SeenKeypoints:
    side = network.options.input_px
    *centre, length = detection.square_px
    crop_from_image = crop_from_square(np.array(centre), float(length), input_px=side)
    crop = to_unit_range(warped(image, crop_from_image, size=(side, side)))
    found = network.keypoints_in_image(
        crop[None].to(network.device), torch.from_numpy(crop_from_image)[None].to(network.device)
    )
    positions, confidence, covariance = (part[0].double().cpu().numpy() for part in found)
    return SeenKeypoints(
        network.model.name, detection.square_px, detection.score, positions, confidence, covariance
    )


def _depth_sigma_m(depth_m: np.ndarray, covariance_px: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """Standard deviation of the depth measured where a keypoint was found, metres.

    What the sensor leaves open, what the corner does, and how much the depth of a surface that is inclined by
    45 degrees changes over the uncertainty of the keypoint's place.
    """
    place_px = np.sqrt(np.trace(covariance_px, axis1=1, axis2=2) / 2)
    inclined_m = place_px * depth_m / np.sqrt(intrinsics.fx * intrinsics.fy)
    sensor_m = np.asarray(depth_sigma_m(depth_m))
    sigma_m: np.ndarray = np.sqrt(sensor_m**2 + KEYPOINT_DEPTH_SIGMA_M**2 + inclined_m**2)
    return sigma_m
