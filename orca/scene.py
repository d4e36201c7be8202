"""A scene: anchors, decoders, how to render them, and where they came from; saved as one safetensors file."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from orca.anchors import GaussianAnchors
from orca.atomic import atomic_path
from orca.camera import Camera
from orca.config import RenderConfig
from orca.conventions import Float32Array
from orca.errors import BadInput
from orca.field.decoders import Decoders
from orca.render.renderer import Renderer

__all__ = ["SCHEMA_VERSION", "Scene"]

SCHEMA_VERSION = 1
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
            with safe_open(str(path), framework="pt") as file:
                document = json.loads((file.metadata() or {})["orca_scene"])
                tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 - not a mapping
        except (OSError, SafetensorError, KeyError, ValueError) as error:
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
        anchors = GaussianAnchors(**{name: tensors[f"anchors.{name}"] for name in _ANCHOR_FIELDS})
        decoders = Decoders(use_direction=bool(document["use_direction"]))
        state = {k.removeprefix("decoders."): v for k, v in tensors.items() if k.startswith("decoders.")}
        decoders.load_state_dict(state)
        camera = document["camera"]
        pose = np.asarray(camera["world_to_camera"])
        view = Camera(np.asarray(camera["K"]), pose, int(camera["width"]), int(camera["height"]))
        return Scene(anchors, decoders, RenderConfig(**document["render_config"]), view, document["provenance"])
    except BadInput:
        raise
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise BadInput(
            f"scene file '{path}' with a missing or broken part ({error})",
            "a scene.safetensors written by `python -m orca reconstruct`",
            "reconstruct the scene again",
        ) from error
