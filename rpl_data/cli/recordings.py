"""The commands about recordings: record, check, import, and the true poses that came with them."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from rpl_data.cli.building import run_build, workspace_for
from rpl_data.formats.recordings.ros.wanted import Topics
from rpl_data.pipeline.object_store import url_of
from rpl_data.types import DataError


def import_(
    recipe: Path,
    workspace: Path | None = None,
    root: Path | None = None,
    again: bool = False,
    object: str | None = None,
    keypoints: str | None = None,
    format: str | None = None,
    camera: tuple[float, ...] | None = None,
    topics: Topics | None = None,
) -> None:
    """Read the recordings of a recipe, or a lone recording, into a workspace; what is left out is named.

    A recording needs no recipe: it is looked at as `rpl init` does, and the recipe is kept in the workspace.

    Example: rpl import my-recording --workspace my-workspace --object mug --keypoints 8

    Args:
        recipe: the YAML file, or a recording; also one in an object store, such as s3://bucket/recording,
            which is copied into the workspace.
        workspace: folder for everything that is made; when left out, the current one if it is a workspace,
            else workspaces/<name of the recipe or recording>.
        root: where the relative paths of the recipe start; the recipe's own folder when left out.
        again: run the stage even if nothing it depends on has changed.
        object: of a lone recording: what the object is called; `object` when left out.
        keypoints: of a lone recording: how many keypoints, or their names with commas; 8 when left out.
        format: of a lone recording: how it is stored; guessed when left out.
        camera: of a lone recording: fx, fy, cx, cy in pixels, as '[600, 600, 320, 240]', then the lens.
        topics: of a lone ROS bag: topics to use, as '{"color": "/cam1/color/image_raw"}'.
    """
    from rpl_data.pipeline.recipe_file import load_recipe

    workspace = workspace or workspace_for(recipe)
    is_remote = url_of(recipe) is not None
    if recipe.suffix in (".yaml", ".yml") or not (is_remote or recipe.exists()):
        if any(option is not None for option in (object, keypoints, format, camera, topics)):
            raise DataError(
                f"{recipe} says what is there and how it is stored; --object, --keypoints, --format, "
                "--camera and --topics are for a recording without a recipe"
            )
        loaded = load_recipe(recipe, root=root)
    else:
        from rpl_data.cli.new_recipe import recipe_at, recipe_for
        from rpl_data.pipeline.first_recipe import HowStored

        told = HowStored(format, camera, topics)
        find = recipe_at if is_remote else recipe_for
        loaded = find(recipe, workspace, object=object, keypoints=keypoints, told=told)
    run_build(loaded, workspace, "import", "import" if again else None)


def capture(
    out: Path,
    scene: str | None = None,
    seconds: float | None = None,
    countdown: int = 3,
    exposure: Literal["lock", "auto"] = "lock",
    preview: Literal["none", "browser"] = "none",
    camera: Literal["realsense", "oak", "orbbec", "k4a", "phone"] = "realsense",
    width: int | None = None,
    height: int | None = None,
    fps: int = 30,
    serial: str | None = None,
    port: int = 8018,
) -> None:
    """Record a scene with a camera: colour, and depth that belongs to its pixels. Ctrl-C ends the recording.

    RealSense, OAK (Luxonis), Orbbec, Azure Kinect (k4a), or an iPhone or iPad with LiDAR that streams over
    USB by the app Record3D. All were tested against simulated devices only, which answer as the makers'
    packages do, and none with real hardware.

    Put the object on a table among other things (texture helps the tracking), 0.4 to 0.8 m away, and walk
    slowly around it for 20 to 40 seconds. Turn the object over or move it, run the same command again for the
    next scene; three scenes or more give a test split. The recording is whole at every moment: when the
    camera is unplugged or the disk is full, everything before that is kept, and every lost frame is reported.

    Then `rpl check OUT` says whether the recording is good, and `rpl init` writes its recipe.

    Example: rpl capture my-recording --seconds 30 --preview browser

    Args:
        out: folder of the recording, of all its scenes; made when it is not there.
        scene: name of the scene; 00, 01, ... when left out.
        seconds: how long; until Ctrl-C when left out.
        countdown: seconds before the recording starts.
        exposure: `lock` holds exposure and white balance at what the automatic finds before the start, so
            that a place looks the same in every frame; `auto` lets them change.
        preview: `browser` shows colour and depth on a page of this machine.
        camera: the kind of camera; all but `realsense` need a package of their own, and say which.
        width: width of the images, pixels; when left out with the height, 640 x 480 for `realsense` and
            `oak`, 1280 x 720 for `orbbec` and `k4a`. A phone chooses itself.
        height: height of the images, pixels.
        fps: images per second; a phone chooses itself.
        serial: serial number of the camera (UDID of a phone), where several are connected.
        port: port of the preview's page.
    """
    from rpl_data.capture import CAMERAS
    from rpl_data.capture.camera import Wanted
    from rpl_data.capture.live import CaptureOptions
    from rpl_data.cli.capture import record_scene

    if (width is None) != (height is None):
        raise DataError("give both --width and --height, or neither")
    size_px = None if width is None or height is None else (width, height)
    record_scene(
        CAMERAS[camera](Wanted(size_px, fps, serial)),
        out,
        scene,
        CaptureOptions(seconds, countdown, exposure),
        preview_port=port if preview == "browser" else None,
    )


def check(
    path: Path,
    format: str | None = None,
    names: tuple[str, ...] | None = None,
    metres_per_unit: float | None = None,
    camera: tuple[float, ...] | None = None,
    topics: Topics | None = None,
    export: str | None = None,
) -> None:
    """Say what is wrong with a recording or an export, and what mends it; changes nothing.

    Of a recording, it looks at about 90 frames of each scene: gaps between frames, repeated images, blur,
    missing depth, lag and shift between colour and depth and, where there are poses, how they are stored, the
    unit of depth and the intrinsics. It says how sure it is.

    Of an export, it looks at all files: which are missing or damaged, and which fields are missing, of
    another kind, out of range, or contradict one another. It names file, record and field, and ends with exit
    status 1 where something is wrong.

    Example: rpl check my-recording; rpl check my-workspace/export/coco

    Args:
        path: a folder of scenes, the folder of one scene, a recording kept in one file (`.bag`, `.db3`,
            `.mcap`, `.klg`), or a recipe (`.yaml`): then its recordings, as the recipe reads and mends them;
            or the folder of an export, or of several, or a workspace: then its exports.
        export: check the folder as an export of this format (coco, yolo, bop ...); guessed when left out.
        format: how the recording is stored; guessed when left out.
        names: only these scenes, as '["00", "01"]'.
        metres_per_unit: metres per unit of the depth images; what the format says when left out.
        camera: fx, fy, cx, cy in pixels, as '[600, 600, 320, 240]', then lens distortion; what the recording
            says when left out.
        topics: topics of a ROS bag to use, as '{"color": "/cam1/color/image_raw"}'; found when left out.
    """
    from tempfile import TemporaryDirectory

    from rpl_data.cli.check import exports_at, print_faults, recordings_at
    from rpl_data.cli.screen import print_diagnoses

    exports = exports_at(path, export) if format is None else []
    if exports:
        print_faults(exports)
        return
    with TemporaryDirectory() as scratch:
        print_diagnoses(
            recordings_at(
                path,
                Path(scratch),
                format=format,
                names=names,
                metres_per_unit=metres_per_unit,
                camera=camera,
                topics=topics,
            )
        )


def truth(
    recipe: Path, cads: Path, out: Path, root: Path | None = None, metres_per_unit: float = 1.0
) -> None:
    """Write the true poses that came with recordings to a file for `truth:` of a recipe.

    BOP, YCB-Video and LabelFusion have poses of CAD models, so the keypoints must be picked on the CAD models
    too: open each in MeshLab, pick the keypoints in the order of the recipe (PickPoints) and save <object>.pp
    beside it. Labelling never sees these poses.

    Example: rpl truth my.yaml models truth.json --metres_per_unit 0.001

    Args:
        recipe: the YAML file; its objects are called as in the dataset (obj_000005, 006_mustard_bottle).
        cads: folder with <object>.obj (or .ply, .stl) and <object>.pp.
        out: the JSON file to write.
        root: where the relative paths of the recipe start; the recipe's own folder when left out.
        metres_per_unit: metres per unit of the CAD models; 0.001 for millimetres, as in BOP.
    """
    from tempfile import TemporaryDirectory

    from rpl_data.cli.truth import write_true_poses
    from rpl_data.pipeline.recipe_file import load_recipe
    from rpl_data.pipeline.sources import recordings_of

    loaded = load_recipe(recipe, root=root)
    with TemporaryDirectory() as scratch:
        recordings = recordings_of(loaded.scenes, unpack=Path(scratch).joinpath)
        counts = write_true_poses(recordings, loaded, cads, out, metres_per_unit=metres_per_unit)
    for name, frames in counts.items():
        print(f"{name}: {frames} frames with a true pose")
