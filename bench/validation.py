"""Is a folder of somebody's frames, videos or splats usable? Looked at scene by scene, before anything is run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.adapters.camera_match import frames_of_case
from bench.adapters.external import KINDS, ExternalSpec, is_external, parse_external
from bench.adapters.frames import frame_files, video_cameras
from bench.adapters.orca_scene import FILE_NAMES
from bench.adapters.sources import one_of, scene_file
from bench.adapters.splat_methods import SCENE_NAMES, read_ply_scene
from bench.adapters.video_facts import VideoFacts, video_facts
from bench.adapters.vistadream import VIDEO_NAMES, unstretched
from bench.adapters.vistadream_scene import read_vistadream_scene
from bench.cameras_io import NamedCamera, natural_key
from bench.datasets.case import SceneCase
from bench.trajectories import Trajectory
from orca.errors import BadInput, OrcaError
from orca.images import load_image
from orca.video import read_video

__all__ = ["SceneReport", "detected", "inspect_scene", "scene_names"]

_IMAGES = (".png", ".jpg", ".jpeg")


@dataclass
class SceneReport:
    """What was found of one scene, as far as it was looked at: filled in until the first problem.

    Attributes:
        scene: its name.
        frames: how many images or video frames; None for splats.
        size: (width, height) in pixels, or None.
        splats: how many, or None.
        first, last: names of the first and last frame, where they are files.
        cameras: how many.
        cameras_sha256: hash of the cameras, as trajectories are hashed, or None.
        problem: the first problem found, or None if the scene is usable.
        fix: what to do about it.
    """

    scene: str
    frames: int | None = None
    size: tuple[int, int] | None = None
    splats: int | None = None
    first: str = ""
    last: str = ""
    cameras: int | None = None
    cameras_sha256: str | None = None
    problem: str | None = None
    fix: str = ""

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)


def detected(text: str) -> ExternalSpec:
    """The kind and folder that ``KIND:PATH`` names, or that a bare PATH looks like.

    Raises:
        BadInput: no such folder, or one that looks like none of the kinds.
    """
    spec = parse_external(text if is_external(text) else f"{_guess(Path(text).expanduser())}:{text}")
    if not spec.path.is_dir():
        raise BadInput(f"no folder {spec.path}", "a folder with one entry a scene", "check the path")
    return spec


def _guess(path: Path) -> str:
    def any_of(*patterns: str) -> bool:
        return any(next(path.glob(pattern), None) is not None for pattern in patterns)

    if not path.is_dir():
        raise BadInput(f"no folder {path}", "a folder with one entry a scene", "check the path")
    looks = (
        ("vistadream-scene", ("*/*.pth", "*.pth")),
        ("vistadream-video", ("*/*video_rgb.mp4", "rgb/*.mp4")),
        ("ply", ("*.ply", "*/*.ply")),
        ("orca-scene", ("*.safetensors", "*/scene.safetensors")),
        ("video", ("*.mp4", "*/*.mp4")),
        ("frames", tuple(f"*/*{suffix}" for suffix in _IMAGES)),
    )
    for kind, patterns in looks:
        if any_of(*patterns):
            return kind
    raise BadInput(
        f"{path} holds no scene",
        "per scene a folder of images, an .mp4, .ply, .pth or .safetensors",
        f"check the path, or say what it is: {', '.join(KINDS)}:{path}",
    )


def scene_names(spec: ExternalSpec) -> tuple[str, ...]:
    """Names of the scenes below a folder: its sub-folders and the stems of its files of that kind."""
    suffix = {"video": ".mp4", "ply": ".ply", "orca-scene": ".safetensors", "vistadream-scene": ".pth"}
    base = spec.path / ("rgb" if spec.kind == "vistadream-video" and (spec.path / "rgb").is_dir() else "")
    ending = suffix.get(spec.kind, ".mp4" if spec.kind == "vistadream-video" else "")
    found = {p.name for p in spec.path.iterdir() if p.is_dir() and base == spec.path and p.name[0] != "."}
    found |= {p.stem for p in base.iterdir() if ending and p.suffix == ending and p.is_file() and p.name[0] != "."}
    return tuple(sorted(found, key=natural_key))


def inspect_scene(spec: ExternalSpec, scene: str, load: Callable[[], SceneCase] | None = None) -> SceneReport:
    """Look at the files of one scene as its method would, and at every frame.

    Args:
        spec: kind and folder.
        scene: name of the scene.
        load: gives the scene of a data set that the frames are meant for; its cameras must match.
    """
    report = SceneReport(scene)
    try:
        _INSPECTORS[spec.kind](spec, report, None if load is None else load())
    except OrcaError as error:
        report.problem, report.fix = error.given, error.fix
    return report


_Inspector = Callable[[ExternalSpec, SceneReport, SceneCase | None], None]


def _note_cameras(report: SceneReport, cameras: Sequence[NamedCamera]) -> None:
    report.cameras = len(cameras)
    sizes = {(named.camera.width, named.camera.height) for named in cameras}
    if len(sizes) > 1:
        raise BadInput(f"cameras of {len(sizes)} image sizes", "one", "render all frames at one size")
    K = np.stack([named.camera.K for named in cameras])
    poses = np.stack([named.camera.world_to_camera for named in cameras])
    report.cameras_sha256 = Trajectory("", K, poses, *sizes.pop()).sha256


def _match(cameras: Sequence[NamedCamera], case: SceneCase | None, where: Path) -> None:
    if case is not None:
        frames_of_case(case, [named.camera for named in cameras], str(where))


def _frames(spec: ExternalSpec, report: SceneReport, case: SceneCase | None) -> None:
    folder = spec.path / report.scene
    files, cameras = frame_files(folder)
    report.frames, report.first, report.last = len(files), files[0].name, files[-1].name
    _note_cameras(report, cameras)
    for file in files:
        image = load_image(file)
        size = (image.shape[1], image.shape[0])
        if report.size not in (None, size):
            raise BadInput(f"{file.name} is {size[0]}x{size[1]}, the first frame {report.size}", "one size", "redo it")
        report.size = size
    _match(cameras, case, folder)


def _video(spec: ExternalSpec, report: SceneReport, case: SceneCase | None) -> None:
    file = scene_file(spec.path, report.scene, ".mp4", "video")
    facts = video_facts(file)
    _note_facts(report, facts, file)
    cameras = video_cameras(file)
    _note_cameras(report, cameras)
    if report.frames != len(cameras):
        raise BadInput(f"{report.frames} frames and {len(cameras)} cameras", "one frame a camera", "write both again")
    _match(cameras, case, file)
    read_video(file, (facts.frames - 1,))  # decodes all of it and keeps one frame


def _note_facts(report: SceneReport, facts: VideoFacts, file: Path) -> None:
    report.frames, report.size, report.first = facts.frames, (facts.width, facts.height), file.name


def _run_video(spec: ExternalSpec, report: SceneReport, case: SceneCase | None) -> None:
    stage = spec.choice("stage", ("refine", "coarse"), "refine")
    file = one_of(spec.path, report.scene, VIDEO_NAMES[stage], f"{stage} video of VistaDream")
    facts = video_facts(file)
    _note_facts(report, facts, file)
    if case is not None:
        if facts.frames != len(case.trajectory):
            raise BadInput(f"{facts.frames} frames", f"{len(case.trajectory)}, as the path", "render along this path")
        like_it = np.zeros((1, facts.height, facts.width, 3), np.uint8)
        unstretched(like_it, case.camera.width, case.camera.height, file.name)
    read_video(file, (facts.frames - 1,))


def _splats(spec: ExternalSpec, report: SceneReport, case: SceneCase | None) -> None:
    if spec.kind == "ply":
        file = scene_file(spec.path, report.scene, ".ply", "splat file")
        cloud = read_ply_scene(file)
    else:
        stage = spec.choice("stage", ("refine", "coarse"), "refine")
        file = one_of(spec.path, report.scene, SCENE_NAMES[stage], f"{stage} scene of VistaDream")
        cloud = read_vistadream_scene(file)
    report.splats, report.first = len(cloud), file.name
    if case is not None:
        from bench.splatting import place

        place(cloud, case.camera, case.depth)


def _orca_scene(spec: ExternalSpec, report: SceneReport, case: SceneCase | None) -> None:
    from orca.scene import Scene

    file = one_of(spec.path, report.scene, FILE_NAMES, "scene file")
    report.splats, report.first = Scene.load(file).num_anchors, file.name


_INSPECTORS: dict[str, _Inspector] = {
    "frames": _frames,
    "video": _video,
    "ply": _splats,
    "vistadream-scene": _splats,
    "vistadream-video": _run_video,
    "orca-scene": _orca_scene,
}
