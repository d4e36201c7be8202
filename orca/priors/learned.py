"""Depth Pro and Depth Anything V2, run by transformers."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from orca.camera import Camera
from orca.conventions import Float32Array, to_uint8
from orca.errors import BadInput, Unavailable
from orca.priors.depth import DepthEstimate, clip_outliers, inverse_to_depth, limit_far
from orca.priors.hub import DEPTH_ANYTHING_V2_SMALL, DEPTH_PRO, HubModel, ModelAccess, locate
from orca.priors.spec import PriorSpec

if TYPE_CHECKING:
    from typing import Self

__all__ = ["DepthAnythingDepth", "DepthProDepth"]


_NARROWEST, _WIDEST = 1.0, 170.0  # degrees


class _TransformersDepth:
    """A depth network of transformers with the image processor that was saved beside it.

    The weights are found and loaded at the first image; `load` does it earlier.
    """

    model: ClassVar[HubModel]
    name: str

    def __init__(self, access: ModelAccess | None = None) -> None:
        self.access = access or ModelAccess()
        self._loaded: tuple[Any, Any] | None = None

    @classmethod
    def from_spec(cls, spec: PriorSpec) -> Self:
        """There are no options: weights come from ``--weights-dir`` or the hub."""
        spec.allow()
        return cls(spec.access)

    def load(self) -> tuple[Any, Any]:
        """The image processor and the network, loaded once.

        Raises:
            Unavailable: files are missing, or transformers is not installed.
            BadInput: the files are no such network.
        """
        if self._loaded is None:
            self._loaded = _load(self.model, self.access)
        return self._loaded

    def estimate(self, image: Float32Array, camera: Camera) -> DepthEstimate:
        """See `DepthProvider`."""
        processor, network = self.load()  # before torch is imported: without weights, that would be for nothing
        import torch

        from orca.threads import multi_threaded_torch

        given = processor(images=to_uint8(image), return_tensors="pt")
        with torch.inference_mode(), multi_threaded_torch():
            output = network(**{key: value.to(self.access.device) for key, value in given.items()})
        notes = self._check_output(output, camera)
        result = processor.post_process_depth_estimation(output, target_sizes=[image.shape[:2]])[0]
        values = np.asarray(result["predicted_depth"].float().cpu().numpy(), np.float32)
        if values.shape != image.shape[:2] or not bool(np.isfinite(values).all()):
            raise BadInput(
                f"{self.model.title} returned shape {values.shape}, finite: {bool(np.isfinite(values).all())}",
                f"a finite map of shape {image.shape[:2]}",
                "use other weights, or another depth provider",
            )
        return self._to_estimate(values, network, result.get("field_of_view")).with_notes(*notes)

    def _check_output(self, output: Any, camera: Camera) -> tuple[str, ...]:
        """Repair what the network says beside the depth; notes about it."""
        return ()

    def _to_estimate(self, values: Float32Array, network: Any, field_of_view: Any) -> DepthEstimate:
        raise NotImplementedError


class DepthProDepth(_TransformersDepth):
    """``depth-pro``: metric depth in metres, and the field of view (Bochkovskii et al. 2025)."""

    model = DEPTH_PRO
    name = "depth-pro"

    def _check_output(self, output: Any, camera: Camera) -> tuple[str, ...]:
        """Depth is scaled by the field of view, so one that no camera has would spoil all of it."""
        if output.field_of_view is None:
            return ()
        degrees = float(output.field_of_view.flatten()[0])
        if math.isfinite(degrees) and _NARROWEST < degrees < _WIDEST:
            return ()
        output.field_of_view = output.field_of_view.new_full(output.field_of_view.shape, camera.hfov_deg)
        return (f"an estimated field of view of {degrees:.1f} degrees was not believed: {camera.hfov_deg:.1f} taken",)

    def _to_estimate(self, values: Float32Array, network: Any, field_of_view: Any) -> DepthEstimate:
        hfov = None if field_of_view is None else float(field_of_view)
        depth, notes = limit_far(clip_outliers(values))
        return DepthEstimate(depth, self.model.title, True, hfov, notes)


class DepthAnythingDepth(_TransformersDepth):
    """``depth-anything``: relative inverse depth (Yang et al. 2024), or metres with weights of a metric variant."""

    model = DEPTH_ANYTHING_V2_SMALL
    name = "depth-anything"

    def _to_estimate(self, values: Float32Array, network: Any, field_of_view: Any) -> DepthEstimate:
        if getattr(network.config, "depth_estimation_type", "relative") == "metric":
            depth, note = limit_far(clip_outliers(values))
            return DepthEstimate(depth, f"{self.model.title}, metric weights", True, None, note)
        inverse = clip_outliers(np.maximum(values, 0.0))
        depth = inverse_to_depth(inverse)
        scaled = np.asarray(depth / np.median(depth), np.float32)
        note = ("relative inverse depth with an unknown offset; farther than 10 times the median depth is set to that",)
        return DepthEstimate(scaled, self.model.title, False, None, note)


def _load(model: HubModel, access: ModelAccess) -> tuple[Any, Any]:
    folder = locate(model, access)
    try:
        from transformers import AutoImageProcessor, AutoModelForDepthEstimation
    except ImportError as error:
        raise Unavailable(
            f"{model.title}: the package transformers is not installed ({error})",
            "the optional dependencies 'models'",
            "pip install 'orca-nvs[models]'",
        ) from error
    try:
        processor = AutoImageProcessor.from_pretrained(folder, local_files_only=True)
        network = AutoModelForDepthEstimation.from_pretrained(folder, local_files_only=True, use_safetensors=True)
    except Exception as error:
        # Whatever transformers stumbles over (json, safetensors, shapes), the files are not this network.
        raise BadInput(
            f"{model.title} in {folder} does not load ({type(error).__name__}: {str(error)[:200]})",
            f"the files of huggingface.co/{model.repo}",
            "get them again",
        ) from error
    return processor, network.to(access.device).eval()
