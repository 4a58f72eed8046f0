"""Apply what a person changed in labels with another program, each time the labels are exported."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from rpl_data.geometry import square_box
from rpl_data.types import Box, Correction, FrameLabel, InstanceLabel, KeypointModel, Rle
from rpl_data.wording import counted


class Corrector:
    """Corrects the labels of one export and counts what it did.

    Args:
        corrections: at most one per scene, frame, object and instance.
        models: the objects, which name the keypoints.
    """

    def __init__(self, corrections: Sequence[Correction], models: Sequence[KeypointModel]) -> None:
        self._given = {(one.scene, one.frame, one.object, one.instance): one for one in corrections}
        self._names = {model.name: model.keypoints for model in models}
        self._applied: Counter[str] = Counter()
        self._left = {key for key, one in self._given.items() if not one.deleted}

    def corrected(self, label: FrameLabel) -> FrameLabel:
        """Apply the corrections of a frame; poses stay as they are."""
        if not self._given:
            return label
        instances = [self._instance(label, instance) for instance in label.instances]
        return replace(label, instances=tuple(one for one in instances if one is not None))

    def _instance(self, label: FrameLabel, instance: InstanceLabel) -> InstanceLabel | None:
        key = (label.scene, label.frame, instance.object, instance.instance)
        change, names = self._given.get(key), self._names.get(instance.object, ())
        if change is None or not _fits(instance, change, names):
            return instance
        self._left.discard(key)
        self._applied.update(
            deleted=int(change.deleted),
            crowd=int(change.crowd),
            mask=int(change.mask is not None),
            keypoints=int(bool(change.keypoints)),
        )
        return None if change.deleted else _corrected(instance, change, names)

    def messages(self) -> list[str]:
        """Say how many corrections were applied, and what may disagree; nothing when there are none."""
        done = self._applied
        said = {
            f"{counted(done['mask'], 'mask')} changed": done["mask"],
            f"keypoints of {counted(done['keypoints'], 'instance')} moved": done["keypoints"],
            f"{counted(done['deleted'], 'instance')} deleted": done["deleted"],
            f"{counted(done['crowd'], 'instance')} marked as ignored (`iscrowd`)": done["crowd"],
        }
        lines = []
        if any(said.values()):
            what = ", ".join(text for text, count in said.items() if count)
            lines.append(
                f"corrected with another program: {what}; `rpl labels forget` drops these corrections"
            )
        if done["keypoints"]:
            lines.append(
                "the poses of instances whose keypoints were moved by hand are still the computed ones: "
                "pose and keypoints may disagree there"
            )
        if self._left:
            lines.append(
                f"{counted(len(self._left), 'correction')} from another program could not be applied: the "
                "labels no longer hold such an instance, with its keypoints and image size; edit the present "
                "export and import it, or drop them with `rpl labels forget`"
            )
        return lines


def _fits(instance: InstanceLabel, change: Correction, names: Sequence[str]) -> bool:
    """Whether a label still has what a correction changes."""
    same_size = change.mask is None or list(change.mask["size"]) == list(instance.mask["size"])
    return same_size and set(change.keypoints) <= set(names)


def _corrected(instance: InstanceLabel, change: Correction, names: Sequence[str]) -> InstanceLabel:
    if change.mask is not None:
        instance = _with_mask(instance, change.mask)
    if change.keypoints:
        instance = _with_keypoints(instance, change.keypoints, names)
    return replace(instance, corrected=True, crowd=change.crowd)


def _with_mask(instance: InstanceLabel, mask: Rle) -> InstanceLabel:
    """Replace the visible mask; the full one holds it, and boxes and visible share follow."""
    from pycocotools import mask as masks

    both = masks.merge([mask, instance.mask_full])
    full: Rle = {"size": list(both["size"]), "counts": both["counts"].decode("ascii")}
    return replace(
        instance,
        mask=mask,
        mask_full=full,
        box=_box(mask),
        box_full=_box(full),
        visib_fract=int(masks.area(mask)) / max(int(masks.area(full)), 1),
    )


def _box(mask: Rle) -> Box:
    from pycocotools import mask as masks

    x, y, width, height = (float(side) for side in masks.toBbox(mask))
    return x, y, x + width, y + height


def _with_keypoints(
    instance: InstanceLabel, moved: Mapping[str, tuple[float, float, int]], names: Sequence[str]
) -> InstanceLabel:
    """Move keypoints; how certain a hand-made one is, nobody knows: its sigma is NaN."""
    pixels, seen = instance.keypoints_px.copy(), instance.visibility.copy()
    sigma = instance.sigma_px.copy()
    for name, (u, v, visible) in moved.items():
        row = list(names).index(name)
        pixels[row] = (u, v) if visible else np.nan
        seen[row], sigma[row] = visible, np.nan
    known = pixels[np.isfinite(pixels).all(axis=1)]
    square = square_box(known) if len(known) > 1 else instance.square_box
    return replace(instance, keypoints_px=pixels, visibility=seen, sigma_px=sigma, square_box=square)
