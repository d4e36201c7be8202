"""Small splat scenes, written in the formats of other programs, and a slow renderer that shares no code with ours."""

from __future__ import annotations

import math
import sys
import types
from pathlib import Path

import numpy as np
import torch

from bench.adapters.splat_cloud import SplatCloud
from bench.datasets import SceneCase
from bench.trajectories import build_trajectory
from orca.camera import Camera

__all__ = ["cloud_of", "flat_case", "render_slowly", "save_vistadream_scene", "write_ply"]


def cloud_of(n: int, degree: int = 0, seed: int = 0, depth: float = 2.0) -> SplatCloud:
    """Random splats around (0, 0, depth)."""
    rng = np.random.default_rng(seed)
    f32 = np.float32
    means = rng.normal(0, 0.4, (n, 3)) + np.array([0, 0, depth])
    return SplatCloud(
        means=means.astype(f32),
        log_scales=np.log(rng.uniform(0.02, 0.15, (n, 3))).astype(f32),
        quaternions=rng.normal(size=(n, 4)).astype(f32),
        opacity_logits=rng.normal(0.5, 1.5, n).astype(f32),
        sh=rng.normal(0, 0.4, (n, (degree + 1) ** 2, 3)).astype(f32),
    )


def flat_case(width: int = 40, height: int = 32, depth: float = 2.0, name: str = "wall") -> SceneCase:
    """A grey wall along a swing of 99 frames."""
    camera = Camera.from_fov(width, height, 60.0)
    return SceneCase(
        dataset="folder",
        name=name,
        image=np.full((height, width, 3), 128, np.uint8),
        camera=camera,
        depth=np.full((height, width), depth, np.float32),
        depth_source="constant",
        depth_is_metric=True,
        fov_source="test",
        trajectory=build_trajectory("swing", camera),
        eval_indices=(0, 10, 20, 98),
    )


def write_ply(path: Path, cloud: SplatCloud) -> None:
    """The layout of 3D Gaussian splatting: harmonics channel by channel."""
    rest = cloud.sh[:, 1:].transpose(0, 2, 1).reshape(len(cloud), -1)
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    names += [f"f_rest_{i}" for i in range(rest.shape[1])] + ["opacity"]
    names += [f"scale_{i}" for i in range(3)] + [f"rot_{i}" for i in range(4)]
    parts = [cloud.means, np.zeros_like(cloud.means), cloud.sh[:, 0], rest, cloud.opacity_logits[:, None]]
    table = np.concatenate([*parts, cloud.log_scales, cloud.quaternions], axis=1).astype("<f4")
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}"]
    head += [f"property float {name}" for name in names] + ["end_header", ""]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes("\n".join(head).encode() + table.tobytes())


def save_vistadream_scene(path: Path, cloud: SplatCloud, frames: int = 2, pose: np.ndarray | None = None) -> None:
    """torch.save of objects whose classes live where VistaDream's do, with the kinds of fields that its have."""
    basic = types.ModuleType("ops.gs.basic")
    kinds = {}
    for name in ("Frame", "Gaussian_Frame", "Gaussian_Scene"):
        kinds[name] = type(name, (), {"__module__": "ops.gs.basic"})
        setattr(basic, name, kinds[name])
    modules = {"ops": types.ModuleType("ops"), "ops.gs": types.ModuleType("ops.gs"), "ops.gs.basic": basic}
    scene = kinds["Gaussian_Scene"]()
    scene.rgbs_act, scene.scales_act, scene.opacity_act = torch.sigmoid, torch.exp, torch.sigmoid
    scene.device, scene.traj_type, scene.dense_trajs = "cuda", "spiral", [np.eye(4) for _ in range(3)]
    scene.frames, scene.gaussian_frames = [], []
    rgb = np.clip(0.5 + 0.28209479177387814 * cloud.sh[:, 0].astype(np.float64), 0.01, 0.99)
    for rows in np.array_split(np.arange(len(cloud)), frames):
        frame, splats = kinds["Frame"](), kinds["Gaussian_Frame"]()
        frame.H, frame.W, frame.prompt, frame.keep = 32, 40, "a wall", False
        frame.rgb, frame.inpaint = np.zeros((4, 4, 3)), np.ones((4, 4), bool)
        frame.intrinsic, frame.extrinsic = np.eye(3), np.eye(4) if pose is None else pose
        frame.mean_depth = np.float64(2.5)
        values = {
            "rgb": np.log(rgb[rows] / (1 - rgb[rows])),
            "scale": cloud.log_scales[rows],
            "opacity": cloud.opacity_logits[rows, None],
            "rotation": cloud.quaternions[rows],
            "xyz": cloud.means[rows],
        }
        for name, value in values.items():
            tensor = torch.from_numpy(np.asarray(value, np.float32))
            setattr(splats, name, torch.nn.Parameter(tensor, requires_grad=False))
        splats.rgbs_deact, splats.scales_deact, splats.device, splats.dpt = torch.logit, torch.log, "cuda", np.ones(3)
        scene.frames.append(frame)
        scene.gaussian_frames.append(splats)
    before = {name: sys.modules.get(name) for name in modules}
    sys.modules.update(modules)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        torch.save(scene, path)
    finally:
        for name, module in before.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module


def render_slowly(cloud: SplatCloud, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """rgb, alpha and depth of a cloud, pixel by pixel and splat by splat in float64, from the paper's formulas."""
    W = camera.world_to_camera @ cloud.input_pose
    fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
    width, height = camera.width, camera.height
    eye = -W[:3, :3].T @ W[:3, 3]
    splats = []
    for i in range(len(cloud)):
        mean = cloud.means[i].astype(float)
        x, y, z = W[:3, :3] @ mean + W[:3, 3]
        if z <= 0.01:
            continue
        q = cloud.quaternions[i].astype(float)
        w, a, b, c = q / np.linalg.norm(q)
        R = np.array(
            [
                [w * w + a * a - b * b - c * c, 2 * (a * b - w * c), 2 * (a * c + w * b)],
                [2 * (a * b + w * c), w * w - a * a + b * b - c * c, 2 * (b * c - w * a)],
                [2 * (a * c - w * b), 2 * (b * c + w * a), w * w - a * a - b * b + c * c],
            ]
        )
        sigma = R @ np.diag(np.exp(2 * cloud.log_scales[i].astype(float))) @ R.T
        sx = min(max(x / z, -0.65 * width / fx), 0.65 * width / fx)
        sy = min(max(y / z, -0.65 * height / fy), 0.65 * height / fy)
        J = np.array([[fx / z, 0, -fx * sx / z], [0, fy / z, -fy * sy / z]]) @ W[:3, :3]
        inverse = np.linalg.inv(J @ sigma @ J.T + 0.3 * np.eye(2))
        direction = mean - eye
        colour = np.maximum(0.5 + harmonics(direction / np.linalg.norm(direction), cloud.sh.shape[1]) @ cloud.sh[i], 0)
        opacity = 1 / (1 + math.exp(-float(cloud.opacity_logits[i])))
        splats.append((z, i, np.array([fx * x / z + cx, fy * y / z + cy]), inverse, colour, opacity))
    splats.sort(key=lambda s: (s[0], s[1]))
    rgb, alpha, depth = np.zeros((height, width, 3)), np.zeros((height, width)), np.zeros((height, width))
    for v in range(height):
        for u in range(width):
            through = 1.0
            for z, _, centre, inverse, colour, opacity in splats:
                d = np.array([u + 0.5, v + 0.5]) - centre
                a = min(0.99, opacity * math.exp(-0.5 * d @ inverse @ d))
                if a < 1 / 255:
                    continue
                rgb[v, u] += through * a * colour
                depth[v, u] += through * a * z
                alpha[v, u] += through * a
                through *= 1 - a
                if through < 1e-4:
                    break
    return rgb, alpha, np.where(alpha > 0, depth / np.maximum(alpha, 1e-12), 0)


def harmonics(direction: np.ndarray, count: int) -> np.ndarray:
    """The constants as the 3D Gaussian splatting code prints them."""
    x, y, z = direction
    out = [0.28209479177387814]
    if count > 1:
        out += [-0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x]
    if count > 4:
        out += [
            1.0925484305920792 * x * y,
            -1.0925484305920792 * y * z,
            0.31539156525252005 * (2 * z * z - x * x - y * y),
            -1.0925484305920792 * x * z,
            0.5462742152960396 * (x * x - y * y),
        ]
    if count > 9:
        out += [
            -0.5900435899266435 * y * (3 * x * x - y * y),
            2.890611442640554 * x * y * z,
            -0.4570457994644658 * y * (4 * z * z - x * x - y * y),
            0.3731763325901154 * z * (2 * z * z - 3 * x * x - 3 * y * y),
            -0.4570457994644658 * x * (4 * z * z - x * x - y * y),
            1.445305721320277 * z * (x * x - y * y),
            -0.5900435899266435 * x * (x * x - 3 * y * y),
        ]
    return np.array(out)
