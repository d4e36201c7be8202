"""A scene: anchors, decoders, how to render them, and where they came from; saved as one safetensors file."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from orca.anchors import GaussianAnchors, Stage
from orca.atomic import atomic_path
from orca.camera import Camera
from orca.config import RenderConfig
from orca.conventions import Float32Array
from orca.errors import BadInput
from orca.field.decoders import Decoders
from orca.images import MAX_PIXELS
from orca.render.renderer import Renderer

__all__ = ["SCHEMA_VERSION", "Scene"]

SCHEMA_VERSION = 1
MAX_BYTES = 16 * 2**30
_ANCHOR_FIELDS = ("means", "log_variances", "quaternions", "opacity_logits", "features", "stage")


@dataclass(frozen=True, eq=False)
class Scene:
    """An explorable scene.

    Attributes:
        anchors: neural Gaussian anchors, on the CPU.
        decoders: density and colour decoders.
        render_config: how the scene was fitted to be rendered.
        camera: the input camera (identity pose).
        provenance: JSON-ready facts: image, depth source, field of view source, preset, seed, scale.
    """

    anchors: GaussianAnchors
    decoders: Decoders
    render_config: RenderConfig
    camera: Camera
    provenance: dict[str, Any] = field(default_factory=dict)

    @property
    def num_anchors(self) -> int:
        """How many anchors there are, of all stages."""
        return len(self.anchors)

    @property
    def num_bytes(self) -> int:
        """Size of all tensors in bytes; the scene file adds a header of a few kB."""
        tensors = [getattr(self.anchors, name) for name in _ANCHOR_FIELDS] + list(self.decoders.parameters())
        return sum(t.numel() * t.element_size() for t in tensors)

    def renderer(self, device: str = "cpu") -> Renderer:
        """A renderer for many views of this scene."""
        return Renderer(self.anchors, self.decoders, self.render_config, device)

    def anchor_colors(self) -> Float32Array:
        """RGB in [0, 1] of each anchor decoded alone, [N, 3]; what a splat export needs."""
        with torch.inference_mode():
            out: Float32Array = self.decoders(self.anchors.features)[1].numpy()
        return out

    def save(self, path: Path | str) -> None:
        """Write the scene to one safetensors file, atomically. The same scene gives the same bytes."""
        from safetensors.torch import save

        tensors = {f"anchors.{name}": getattr(self.anchors, name).contiguous() for name in _ANCHOR_FIELDS}
        tensors |= {f"decoders.{k}": v.detach().contiguous() for k, v in self.decoders.state_dict().items()}
        document = {
            "schema_version": SCHEMA_VERSION,
            "render_config": asdict(self.render_config),
            "use_direction": self.decoders.use_direction,
            "camera": {
                "K": self.camera.K.tolist(),
                "world_to_camera": self.camera.world_to_camera.tolist(),
                "width": self.camera.width,
                "height": self.camera.height,
            },
            "provenance": self.provenance,
        }
        with atomic_path(path) as temporary:
            temporary.write_bytes(save(tensors, metadata={"orca_scene": json.dumps(document, sort_keys=True)}))

    @staticmethod
    def load(path: Path | str) -> Scene:
        """Read a scene file; raises `BadInput` for anything that is not one."""
        from safetensors import SafetensorError, safe_open

        try:
            if Path(path).stat().st_size > MAX_BYTES:
                raise ValueError(f"more than {MAX_BYTES} bytes")
            with safe_open(str(path), framework="pt") as file:
                document = json.loads((file.metadata() or {})["orca_scene"])
                tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 - not a mapping
        except (OSError, SafetensorError, KeyError, ValueError, RecursionError) as error:
            raise BadInput(
                f"'{path}' is not a scene file ({type(error).__name__}: {error})",
                "a scene.safetensors written by `python -m orca reconstruct`",
                "check the path",
            ) from error
        return _assemble(document, tensors, Path(path))


def _assemble(document: dict[str, Any], tensors: dict[str, torch.Tensor], path: Path) -> Scene:
    version = document.get("schema_version") if isinstance(document, dict) else None
    if version != SCHEMA_VERSION:
        raise BadInput(
            f"scene file '{path}' of schema version {version}",
            f"version {SCHEMA_VERSION}",
            "reconstruct the scene again with this version",
        )
    try:
        _check_tensors(tensors)
        anchors = GaussianAnchors(**{name: tensors[f"anchors.{name}"] for name in _ANCHOR_FIELDS})
        decoders = Decoders(use_direction=bool(document["use_direction"]))
        state = {k.removeprefix("decoders."): v for k, v in tensors.items() if k.startswith("decoders.")}
        decoders.load_state_dict(state)
        camera = document["camera"]
        pose = np.asarray(camera["world_to_camera"])
        view = Camera(np.asarray(camera["K"]), pose, int(camera["width"]), int(camera["height"]))
        if view.width * view.height > MAX_PIXELS or not isinstance(document["provenance"], dict):
            raise ValueError(f"a camera of {view.width}x{view.height} pixels, or no provenance")
        return Scene(anchors, decoders, _render_config(document["render_config"]), view, document["provenance"])
    except BadInput:
        raise
    except (KeyError, TypeError, ValueError, RuntimeError, OverflowError) as error:
        raise BadInput(
            f"scene file '{path}' with a missing or broken part ({error})",
            "a scene.safetensors written by `python -m orca reconstruct`",
            "reconstruct the scene again",
        ) from error


def _check_tensors(tensors: dict[str, torch.Tensor]) -> None:
    """Finite float32, but for the stage: compiled code indexes by what is computed from these numbers."""
    for name, tensor in tensors.items():
        if name == "anchors.stage":
            if tensor.dtype != torch.uint8 or (tensor.numel() and int(tensor.max()) >= len(Stage)):
                raise ValueError(f"{name} of {tensor.dtype}, or a stage that there is not")
        elif tensor.dtype != torch.float32 or not bool(torch.isfinite(tensor).all()):
            raise ValueError(f"{name} of {tensor.dtype}, where finite float32 is needed")


def _render_config(fields: dict[str, Any]) -> RenderConfig:
    """The configuration of a file; raises `ValueError` for one that cannot be rendered with."""
    config = RenderConfig(**fields)
    whole = (config.max_hits, config.window)
    real = (config.chi2, config.near, config.layer_gap_sigmas, config.layer_gap_relative, config.background)
    known = all(type(value) is int for value in whole) and all(type(value) in (int, float) for value in real)
    if not known or config.decode not in ("layered", "per_hit") or config.backdrop not in ("surroundings", "plain"):
        raise ValueError(f"a render_config of {fields}")
    if not (1 <= config.max_hits <= 4096 and -1 <= config.window <= 4096 and 0 < config.chi2 < 1e4):
        raise ValueError(f"max_hits {config.max_hits}, window {config.window}, chi2 {config.chi2}")
    if not all(0 <= value < 1e6 for value in real):
        raise ValueError(f"a render_config of {fields}")
    return config
