"""Detector, hourglass and PnP in a row: an image to the poses of its objects (the paper's figure of IV-C)."""

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
from rpl_data.torch.images import to_unit_range
from rpl_data.torch.transforms import crop_from_square, warped
from rpl_data.types import DataError, DepthImage, Intrinsics
from training.detection.module import Detection, DetectorTraining, load_detector
from training.keypoints.module import KeypointTraining, load_keypoints

LEAST_CONFIDENCE = 0.1
"""Of a keypoint that is used at all; the covariance weighs the others."""


@dataclass(frozen=True)
class SeenKeypoints:
    """What the hourglass says about one object, in pixels of the full image; k keypoints.

    Attributes:
        square_px: cx, cy, side of the crop.
        score: of the detection; 1 where the crop was given.
        positions_px: k x 2.
        confidence: k, 0 to 1.
        covariance_px: k x 2 x 2.
    """

    object: str
    square_px: np.ndarray
    score: float
    positions_px: np.ndarray
    confidence: np.ndarray
    covariance_px: np.ndarray


@dataclass(frozen=True)
class PosePipeline:
    """Trained networks.

    Attributes:
        networks: an hourglass an object, by name.
        detector: None where crops are given.
    """

    networks: Mapping[str, KeypointTraining]
    detector: DetectorTraining | None = None

    def see(
        self, image: np.ndarray, squares_px: Mapping[str, np.ndarray] | None = None
    ) -> list[SeenKeypoints]:
        """Keypoints of the objects of an RGB image.

        Args:
            image: height x width x 3, uint8.
            squares_px: cx, cy, side of each object's crop by name; detected when left out.
        """
        if squares_px is not None:
            found = {name: Detection(np.asarray(square), 1.0) for name, square in squares_px.items()}
        elif self.detector is not None:
            found = self.detector.detect(image)
        else:
            raise DataError("without --detector, a checkpoint of train_detector, the crops must be given")
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
        """``camera_from_object`` in the frame of the model the network was trained with.

        Args:
            seen: of `see`.
            intrinsics: the camera of the full image.
            method: `epnp` and `sqpnp` believe every keypoint and are not refined, as in the paper; the
                others leave wrong ones out and weigh the rest by their covariance.
            depth: registered to the image; pins the distance.
        """
        used = np.where(seen.confidence[:, None] >= LEAST_CONFIDENCE, seen.positions_px, np.nan)
        depth_m = None if depth is None else depths_at(depth, used)
        given = correspondences(
            self.networks[seen.object].model.points_object,
            used,
            intrinsics,
            covariance_px=seen.covariance_px,
            depth_m=depth_m,
            depth_sigma_m=None if depth_m is None else KEYPOINT_DEPTH_SIGMA_M + _sigma(depth_m),
        )
        return estimate_pose(given, method=method, refine=method in ("ransac", "consensus"))


KEYPOINT_DEPTH_SIGMA_M = 0.006
"""Beside a corner, the depth about a keypoint is that of another point of the surface."""


def read_depth_m(path: Path, metres_per_unit: float, *, like: np.ndarray) -> DepthImage:
    """A 16-bit depth image in metres, 0 = none.

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
    """The pipeline of checkpoints, one of `train_keypoints` an object; DataError when that is not so."""
    if not networks:
        raise DataError("no keypoint network is named; --keypoints takes a list: '[run/last.ckpt]'")
    loaded = [load_keypoints(path) for path in networks]
    by_name = {network.model.name: network for network in loaded}
    if len(by_name) < len(loaded):
        raise DataError(
            f"two checkpoints are of the same object: {', '.join(str(path) for path in networks)}"
        )
    return PosePipeline(by_name, None if detector is None else load_detector(detector))


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


def _sigma(depth_m: np.ndarray) -> np.ndarray:
    sigma: np.ndarray = np.asarray(depth_sigma_m(depth_m))
    return sigma
