"""Recipes: a YAML file that says where scenes come from, which objects they show, and what to make.

The dataclasses below are the grammar; a recipe file has exactly their fields, and may have `method: paper`,
which stands for options of the stages (`presets.py`). Other keys are refused, naming the nearest valid key,
so a misspelt option never passes for a default.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from rpl_data.drift.drift import MAX_DRIFT_MM
from rpl_data.export.color_images import ColorFormat
from rpl_data.export.folder import Images
from rpl_data.export.split import SplitRule
from rpl_data.formats.masks.given import MaskFormat
from rpl_data.formats.recordings.ros.wanted import Topics
from rpl_data.recordings.mend import Mend
from rpl_data.twin.spec import TwinSpec


@dataclass(frozen=True)
class MaskSource:
    """Masks of the objects that another program made (SAM 2, Cutie, an annotation tool).

    They vote in the segmentation, where the surface is seen mostly outside them, and check the labels; they
    never become labels. A frame whose mask contradicts the others is out-voted and named.

    Attributes:
        path: the folder or file; where it has a folder `<scene>` (or `<scene>.json`), that is the scene's.
        format: `png`: `<frame>.png` with 0 and 255, or a number per object, also by palette (SAM 2, Cutie,
            XMem); `folders`: `<object>/<frame>.png` (SAM 2 with one file per object); `coco`: polygons or run
            lengths. Frames are those of the same name, or number, as the colour images.
        objects: which number, folder or category each object has, `{cup: 1, drill: 2}`. Where it is left out,
            names that are those of objects count, and the others go by where the clicks fall.
    """

    path: Path
    format: MaskFormat = "png"
    objects: dict[str, int | str] | None = None


@dataclass(frozen=True)
class SceneSource:
    """Source of some scenes.

    Attributes:
        path: a folder of scenes, or one scene; or its address in an object store, such as
            `s3://bucket/recording`, from which it is copied into the workspace.
        format: how they are stored; `rpl` is a RapidPoseLabels tree (`camera.txt` and, per scene,
            `rgb/`, `depth/`, `associations.txt`, `camera.poses`). `docs/recordings.md` lists the others.
        names: the scenes of the folder to use; all when left out.
        metres_per_unit: metres per unit of the stored depth; the format's own when left out
            (0.001 for `rpl`: millimetres).
        camera: fx, fy, cx, cy in pixels, then 0, 4, 5 or 8 numbers of OpenCV's lens distortion; that of the
            recording when left out.
        registered: whether depth is aligned to the pixels of the colour image; as the format implies when
            left out.
        mend: faults of these recordings to correct while they are read; `rpl check` names them.
        topics: which topics of a ROS bag to use (`{color: ..., depth: ..., poses: /tf}`); found by their
            names when left out, without poses.
        masks: masks that another program made of the objects in these scenes.
        moving: the objects of these scenes are moved while they are filmed (true, or names of scenes): each
            frame has its own pose, followed on the object's surface from frames with clicks on at least
            three keypoints. The object must be filmed standing still in other scenes.
    """

    path: Path
    format: str = "rpl"
    names: tuple[str, ...] | None = None
    metres_per_unit: float | None = None
    camera: tuple[float, ...] | None = None
    registered: bool | None = None
    mend: Mend = Mend()
    topics: Topics | None = None
    masks: MaskSource | None = None
    moving: bool | tuple[str, ...] = False

    def moves(self, scene: str) -> bool:
        """Whether the objects of a scene are moved."""
        return self.moving if isinstance(self.moving, bool) else scene in self.moving


@dataclass(frozen=True)
class CropBox:
    """A box in the object frame, metres; the dense model is cut to it.

    The object frame has its origin at the centroid of the keypoints and the axes of the first scene.
    """

    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]


@dataclass(frozen=True)
class AxisRecipe:
    """An axis about which an object looks the same after some turns; `rpl symmetry` shows such numbers.

    Attributes:
        axis: its direction, in the object frame of the workspace.
        turns: 2 = after half a turn, 4 = after each quarter, `any` = after any.
        point_m: a point on it, metres; the origin when left out.
    """

    axis: tuple[float, float, float]
    turns: int | Literal["any"]
    point_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class ObjectRecipe:
    """One object.

    Attributes:
        name: its name; the category of the exported dataset.
        keypoints: their number, or their names in order.
        clicks: CSV file with the clicks, `object,keypoint,scene,frame,u_px,v_px`; left out when they
            are already in the workspace (`rpl clicks import`, the annotation page).
        skeleton: pairs of keypoint numbers (from 0) to draw a line between.
        crop: cut the dense model to this box; rarely needed.
        symmetry: `none`, or the axes about which it looks the same; what was confirmed by `rpl symmetry` when
            left out.
    """

    name: str
    keypoints: int | tuple[str, ...]
    clicks: Path | None = None
    skeleton: tuple[tuple[int, int], ...] = ()
    crop: CropBox | None = None
    symmetry: Literal["none"] | tuple[AxisRecipe, ...] | None = None

    @property
    def keypoint_names(self) -> tuple[str, ...]:
        """Names in order; "0", "1", ... when only a number is given."""
        if isinstance(self.keypoints, int):
            return tuple(str(number) for number in range(self.keypoints))
        return self.keypoints


@dataclass(frozen=True)
class Reconstruct:
    """Source of the camera's trajectory.

    Attributes:
        method: `auto` keeps the poses of the recording where its images agree with them, corrects them where
            they do not, and computes them where there are none; `given` takes them as they are; `track`
            computes them from the images, and leaves out the frames where that fails.
        voxel_m: size of a voxel of the fused surface.
        max_drift_mm: a recording whose poses drift farther than this over time, as its depth images show,
            is cut into several scenes, each placed by its own clicks.
    """

    method: Literal["auto", "given", "track"] = "auto"
    voxel_m: float = 0.003
    max_drift_mm: float = MAX_DRIFT_MM


@dataclass(frozen=True)
class Solve:
    """How the sparse model is solved from clicks.

    Attributes:
        method: `robust` tolerates wrong clicks and wrong depths; `slsqp` is the paper's: the depth of the
            clicked pixel itself, and Eq. 2 by SciPy's SLSQP.
    """

    method: Literal["robust", "slsqp"] = "robust"


@dataclass(frozen=True)
class RefineRecipe:
    """What the depth and colour of the recording may correct of the solution of the clicks.

    Attributes:
        scenes: register the surfaces of an object's scenes on one another, together with the clicks; a
            scene keeps the pose of its clicks where parts of the surface left out of that do not gain.
        frames: correct the object's pose in single frames by what slower frames show printed on it: `auto`
            where parts of the print left out of that agree with it, and by half a pixel or more; true
            wherever the print can be aligned, without that evidence.
    """

    scenes: bool = True
    frames: bool | Literal["auto"] = "auto"


@dataclass(frozen=True)
class SegmentRecipe:
    """How the dense model is made.

    Attributes:
        method: `convex` grows regions across smooth and convex edges, without what the object stands on, and
            closes them; `smooth` is the paper's: region growing as in the Point Cloud Library, seeded by the
            keypoints, nothing closed.
    """

    method: Literal["convex", "smooth"] = "convex"


@dataclass(frozen=True)
class LabelRecipe:
    """Which frames are labelled, and how masks are made.

    Attributes:
        rate: frames per second (the paper's 3 Hz), or `all`.
        method: `mesh` casts rays at the dense model's triangles; `splat` is the paper's: its points are
            projected, and the gaps between them are closed.
    """

    rate: float | Literal["all"] = 3.0
    method: Literal["mesh", "splat"] = "mesh"

    @property
    def rate_hz(self) -> float | None:
        """Frames per second; None = every frame."""
        return None if self.rate == "all" else float(self.rate)

    @property
    def dots(self) -> bool:
        """Masks are made of the dense model's points."""
        return self.method == "splat"


FrameChoice = Literal["keypoints", "box", "up"] | tuple[str, str, str]
"""The object frame of exports."""


@dataclass(frozen=True)
class ExportRecipe:
    """What is exported. A plain list, `export: [coco, yolo]`, gives the formats alone.

    Attributes:
        formats: `coco`, and `yolo`, `bop` and `okt` (ObjectKeypointTrainer), made from it.
        min_quality: a frame is left out when one of its labels has a lower quality; how many is said. A
            label's quality is 1 / (1 + e / 5 px), where e is its expected error: 0.25 stands for 15 px, 0.5
            for 5 px. 0 keeps all.
        color: format of the colour images of `bop` and `bop_onboarding`: `recorded` takes all as they are,
            `png` and `jpg` convert others. PNG suits readers that find the depth image by replacing `rgb` in
            a path.
        frame: the object frame of poses, keypoints and meshes. `keypoints`: the workspace's own, with its
            origin at their centroid; `box`: its axes, with the origin at the centre of the box around the
            mesh; `up`: z up from the table, x along the longest side, origin at the centre of that box; or
            three keypoints: the origin, where x points to, and a third in the plane of x and y.
        images: `copy` puts copies of the images into `coco`, and links to these into the other formats, so
            that no program that writes into an export can change the recording; they take no space where the
            file system can clone files. `link` never takes space, but such a program changes the recording.
        license: under which the dataset may be used, for its card (`export/coco/README.md`).
        to: address in an object store, such as `s3://bucket/cups`, that the exports are copied to: a folder
            for each format, with the list `rpl-manifest.json`, which is there only when all files are.
    """

    formats: tuple[str, ...] = ("coco",)
    min_quality: float = 0.25
    color: ColorFormat = "recorded"
    frame: FrameChoice = "keypoints"
    images: Images = "copy"
    license: str | None = None
    to: str | None = None


@dataclass(frozen=True)
class Recipe:
    """Everything `rpl build` needs to know.

    Attributes:
        name: name of the dataset.
        scenes: sources of the scenes.
        objects: the objects to label.
        twin: first make a synthetic recording with exact ground truth, in `recording/` of the workspace;
            scenes, objects, clicks and truth then default to those of this recording.
        reconstruct, solve, refine, segment, label, split: options of the stages.
        export: formats to write, and which labels are good enough.
        truth: the ground truth of these scenes, if it is known: a workspace folder, or a JSON file
            `{points_<object>: K x 3, camera_from_<object>: {scene: [4x4 per frame]}}`. The quality
            table is made when it is given (a twin has its own).
    """

    name: str
    scenes: tuple[SceneSource, ...] = ()
    objects: tuple[ObjectRecipe, ...] = ()
    twin: TwinSpec | None = None
    reconstruct: Reconstruct = Reconstruct()
    solve: Solve = Solve()
    refine: RefineRecipe = RefineRecipe()
    segment: SegmentRecipe = SegmentRecipe()
    label: LabelRecipe = LabelRecipe()
    split: SplitRule = SplitRule()
    export: ExportRecipe = ExportRecipe()
    truth: Path | None = None
