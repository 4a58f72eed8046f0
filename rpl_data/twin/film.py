"""One video of a twin: its scene, its camera path, and each frame with its ground truth."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float64, Int64

from rpl_data.geometry import Transform, box_around, inside_image, invert, project, transform
from rpl_data.label.instance import square_around
from rpl_data.twin.objects import TwinObject, build
from rpl_data.twin.renderer import Rendered, Renderer
from rpl_data.twin.scene import TwinScene, carried, compose
from rpl_data.twin.sensor import PerfectView, measure_color, measure_depth, shifted
from rpl_data.twin.sensor.motion import Twist, flow_px_s, image_flow_px_s, row_delay_s, twist
from rpl_data.twin.spec import TwinSpec
from rpl_data.twin.trajectory import hand_held
from rpl_data.types import Box, ColorImage, DepthImage, FrameLabel, InstanceLabel, Rle

SEEN_WITHIN_M = 0.001
"""A landmark lies on its surface, so a surface this close in front of it does not hide it."""
INSTANT_S = 0.002
"""The camera's velocity is measured between this long before and this long after a frame."""


@dataclass(frozen=True)
class Shot:
    """A frame as the sensor records it, with its ground truth."""

    color: ColorImage
    depth_m: DepthImage
    perfect: Rendered
    label: FrameLabel


@dataclass(frozen=True)
class Film:
    """A video that can be rendered frame by frame.

    Attributes:
        objects: the objects of this scene, in the spec's order, one per instance.
        instances: names of the instances: the first of an object has none, the others are 2, 3, ...
        table_from_camera: one pose per frame, in the middle of its exposure.
        twists: velocity of the camera at those moments.
        table_from_imager: pose of the camera when it took the depth image of each frame.
    """

    spec: TwinSpec
    number: int
    objects: tuple[TwinObject, ...]
    instances: tuple[str, ...]
    scene: TwinScene
    table_from_camera: Float64[np.ndarray, "n 4 4"]
    twists: tuple[Twist, ...]
    table_from_imager: Float64[np.ndarray, "n 4 4"]

    @cached_property
    def renderer(self) -> Renderer:
        """The renderer of the scene, prepared on first use."""
        return Renderer(self.scene, self.spec.intrinsics)

    @cached_property
    def times_s(self) -> Float64[np.ndarray, " n"]:
        """Time of each frame."""
        return self.spec.times_s(self.number)

    @property
    def scene_from_camera(self) -> Float64[np.ndarray, "n 4 4"]:
        """The trajectory, in the frame of the first camera."""
        poses: Float64[np.ndarray, "n 4 4"] = invert(self.table_from_camera[0]) @ self.table_from_camera
        return poses

    def scene_from_object(self, number: int) -> Transform:
        """Pose of an object, in the frame of the first camera."""
        pose: Transform = invert(self.table_from_camera[0]) @ self.scene.table_from_object[number]
        return pose

    @property
    def moves(self) -> bool:
        """Whether the first object is carried about."""
        return self.spec.casts[self.number].moving

    def at(self, frame: int) -> Film:
        """The video with its objects where they are in a frame."""
        if not self.moves:
            return self
        share = self.times_s[frame] / max(float(self.times_s[-1]), 1e-9)
        return replace(self, scene=carried(self.scene, share))

    def shoot(self, frame: int) -> Shot:
        """Render a frame; the same spec, scene and frame always give the same pixels."""
        if self.moves:
            return self.at(frame)._shot(frame)
        return self._shot(frame)

    def _shot(self, frame: int) -> Shot:
        rng = np.random.default_rng([self.spec.seed, self.number, 1, frame])
        perfect = self.renderer.render(self.table_from_camera[frame])
        older = perfect
        if self.spec.sensor.lag_frames:
            older = self.renderer.render(self.table_from_imager[frame])
        view = PerfectView(older.depth_m, older.cos_incidence, older.albedo, older.shininess)
        sensor, intrinsics = self.spec.sensor, self.spec.intrinsics
        view = shifted(view, sensor.shift_px)
        depth_m = measure_depth(view, sensor.depth, focal_px=intrinsics.fx, rng=rng)
        flow = image_flow_px_s(intrinsics, perfect.depth_m, self.twists[frame])
        color = measure_color(perfect.color, sensor.color, flow_px_s=flow, rng=rng)
        return Shot(color, depth_m, perfect, self._label(frame, perfect.thing))

    def as_shown(self, label: FrameLabel) -> FrameLabel:
        """Move the label's keypoints to where the image shows them: rows are exposed at different times."""
        instances = tuple(
            replace(one, keypoints_px=self._shown_px(one, label.frame)) for one in label.instances
        )
        return replace(label, instances=instances)

    def _shown_px(self, label: InstanceLabel, frame: int) -> Float64[np.ndarray, "k 2"]:
        one = next(thing for thing in self.objects if thing.model.name == label.object)
        depth_m = transform(label.camera_from_object, one.model.points_object)[:, 2]
        intrinsics, readout_s = self.spec.intrinsics, self.spec.sensor.color.readout_s
        later_s = row_delay_s(label.keypoints_px[:, 1], intrinsics.height, readout_s)
        flow = flow_px_s(intrinsics, label.keypoints_px, depth_m, self.twists[frame])
        shown: Float64[np.ndarray, "k 2"] = label.keypoints_px + flow * later_s[:, None]
        return shown

    def _label(self, frame: int, thing: Int64[np.ndarray, "height width"]) -> FrameLabel:
        found = (self._instance(number, frame, thing) for number in range(len(self.objects)))
        instances = tuple(instance for instance in found if instance is not None)
        return FrameLabel(self.spec.scene_names[self.number], frame, float(self.times_s[frame]), instances)

    def _instance(
        self, number: int, frame: int, thing: Int64[np.ndarray, "height width"]
    ) -> InstanceLabel | None:
        """The exact label of an object; None when no part of it projects into the image."""
        table_from_camera, table_from_object = (
            self.table_from_camera[frame],
            self.scene.table_from_object[number],
        )
        full = self.renderer.full_mask(number, table_from_camera)
        if not full.any():
            return None
        visible, full_box = thing == number, _box(full)
        camera_from_object = invert(table_from_camera) @ table_from_object
        one, intrinsics = self.objects[number], self.spec.intrinsics
        keypoints_px = project(intrinsics, transform(camera_from_object, one.model.points_object))
        surface_px = project(intrinsics, transform(camera_from_object, one.surface.vertices))
        return InstanceLabel(
            object=one.model.name,
            camera_from_object=camera_from_object,
            keypoints_px=keypoints_px,
            visibility=self._visibility(number, keypoints_px, table_from_camera),
            sigma_px=np.zeros(len(keypoints_px)),
            square_box=square_around(keypoints_px, full_box),
            box=_box(visible) if visible.any() else None,
            box_full=full_box,
            mask=_encode(visible),
            mask_full=_encode(full),
            visib_fract=min(1.0, float(visible.sum() / full.sum())),
            truncated=not bool(inside_image(intrinsics, surface_px).all()),
            quality=1.0,
            instance=self.instances[number],
        )

    def _visibility(
        self, number: int, keypoints_px: Float64[np.ndarray, "k 2"], table_from_camera: Transform
    ) -> Int64[np.ndarray, " k"]:
        """COCO's v: 2 seen, 1 hidden by the object itself or by something else, 0 outside the image."""
        points = transform(self.scene.table_from_object[number], self.objects[number].model.points_object)
        seen = self.renderer.sees(points, table_from_camera, tolerance_m=SEEN_WITHIN_M)
        inside = inside_image(self.spec.intrinsics, keypoints_px)
        return np.where(inside, np.where(seen, 2, 1), 0).astype(np.int64)


def film(spec: TwinSpec, number: int) -> Film:
    """Prepare video `number` of a twin; everything follows from the spec.

    Raises:
        DataError: the spec names an object that does not exist.
    """
    cast = spec.casts[number].objects
    shown = [(thing, k) for thing in spec.things for k in range(cast.count(thing.name))]
    objects = tuple(build(thing) for thing, _ in shown)
    instances = tuple("" if k == 0 else str(k + 1) for _, k in shown)
    before = Counter(name for earlier in spec.casts[:number] for name in earlier.objects)
    turns = [before[thing.name] + k for thing, k in shown]
    rng = np.random.default_rng([spec.seed, number, 0])
    scene = compose(objects, rng=rng, number=number, turns=turns, clutter=spec.clutter, plain=spec.plain_room)
    times_s = spec.times_s(number)
    moments_s = [times_s, times_s - INSTANT_S, times_s + INSTANT_S, times_s - spec.lag_s]
    poses = hand_held(
        rng,
        times_s=np.concatenate(moments_s),
        target_m=scene.target_m,
        sweep_deg=spec.sweep_deg,
        distance_m=spec.distance_m,
        elevation_deg=spec.elevation_deg,
        span_s=(float(times_s[0]), float(times_s[-1])),
    )
    now, earlier, later, imager = np.split(poses, len(moments_s))
    twists = tuple(twist(*pair, 2 * INSTANT_S) for pair in zip(earlier, later, strict=True))
    return Film(spec, number, objects, instances, scene, now, twists, imager)


def _box(mask: Bool[np.ndarray, "height width"]) -> Box:
    rows, columns = np.nonzero(mask)
    return box_around(np.column_stack([columns, rows]).astype(float))


def _encode(mask: Bool[np.ndarray, "height width"]) -> Rle:
    from pycocotools import mask as coco_mask

    encoded = coco_mask.encode(np.asfortranarray(mask, dtype=np.uint8))
    return Rle(size=[int(n) for n in encoded["size"]], counts=encoded["counts"].decode("ascii"))
