"""The best prior that is here: which one ran, and why the better ones did not, is part of the result."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from orca.camera import Camera
from orca.conventions import Float32Array
from orca.errors import BadInput, OrcaError
from orca.priors.depth import DEPTH_PROVIDERS, DepthEstimate, DepthProvider
from orca.priors.hub import ModelAccess
from orca.priors.spec import PriorSpec

if TYPE_CHECKING:
    from typing import Self

__all__ = ["AutoDepth"]

_log = logging.getLogger(__name__)


@dataclass
class AutoDepth:
    """``auto``: Depth Pro, else Depth Anything V2 Small, else the ONNX network if one is given, else the heuristic.

    The network is given as ``auto:NET.onnx?size=384&range=255&meaning=inverse_depth`` (options as for ``onnx``). A
    depth file beside the image comes before all of these; whoever knows the image's path looks for it. Once one has
    answered, it answers for every further image of the run.
    """

    onnx: PriorSpec | None = None
    access: ModelAccess = field(default_factory=ModelAccess)
    name: str = "auto"
    _chosen: DepthProvider | None = None

    @classmethod
    def from_spec(cls, spec: PriorSpec) -> Self:
        """A file is an ONNX network with its options; there are no others."""
        if spec.path is None:
            spec.allow()
            return cls(None, spec.access)
        network = PriorSpec("onnx", spec.path, spec.options, spec.access)
        DEPTH_PROVIDERS.get("onnx").from_spec(network)  # a wrong option is said now, not after two downloads
        return cls(network, spec.access)

    @property
    def chosen(self) -> DepthProvider | None:
        """Who answered; None before the first image."""
        return self._chosen

    def estimate(self, image: Float32Array, camera: Camera) -> DepthEstimate:
        """See `DepthProvider`; the notes say which candidates did not run and why."""
        if self._chosen is not None:
            return self._chosen.estimate(image, camera)
        notes: list[str] = []
        for spec in self._candidates():
            provider = DEPTH_PROVIDERS.get(spec.name).from_spec(spec)
            try:
                found = provider.estimate(image, camera)
            except (OrcaError, RuntimeError, MemoryError) as error:
                reason = error.given if isinstance(error, OrcaError) else f"{type(error).__name__}: {str(error)[:200]}"
                notes.append(f"{spec.name} did not run: {reason}")
                _log.info("%s", notes[-1])
                continue
            self._chosen = provider
            return found.with_notes(*notes)
        raise BadInput("no depth provider that runs on this image", "the heuristic always does", "check the image")

    def _candidates(self) -> tuple[PriorSpec, ...]:
        learned = tuple(PriorSpec(name, access=self.access) for name in ("depth-pro", "depth-anything"))
        return (*learned, *((self.onnx,) if self.onnx else ()), PriorSpec("heuristic"))
