"""Names of priors to objects; ``auto`` takes the best that is here, and why not a better one is part of the result."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from orca.errors import Unavailable
from orca.priors.auto import AutoDepth
from orca.priors.depth import DepthProvider
from orca.priors.diffusion import DiffusionInpainter
from orca.priors.diffusion_config import DiffusionConfig
from orca.priors.exemplar import ExemplarInpainter
from orca.priors.grow import ClassicalOutpainter, DiffusionOutpainter
from orca.priors.hub import DEPTH_ANYTHING_V2_SMALL, DEPTH_PRO, SD15_INPAINTING, ModelAccess, locate
from orca.priors.inpaint import INPAINTERS, Inpainter
from orca.priors.learned import DepthAnythingDepth, DepthProDepth
from orca.priors.outpaint import OUTPAINTERS, Outpainter

if TYPE_CHECKING:
    from orca.config import ReconstructConfig

__all__ = [
    "INPAINTER_CHOICES",
    "OUTPAINTER_CHOICES",
    "Priors",
    "choose_depth_estimator",
    "choose_inpainter",
    "choose_outpainter",
]

INPAINTER_CHOICES = ("auto", "none", *INPAINTERS)
OUTPAINTER_CHOICES = ("auto", "none", *OUTPAINTERS)

# Providers whose depth of a new picture means something: not a file, which belongs to another picture, nor a guess.
_ESTIMATORS = ("depth-pro", "depth-anything", "onnx")


@dataclass(frozen=True)
class Priors:
    """Who adds what is not in the image.

    Attributes:
        outpainter: what lies beyond the frame; None adds nothing.
        inpainter: large holes; None leaves them to local repair.
        depth: estimates depth of what those two made; None continues the known depth.
        notes: why "auto" took no better one.
    """

    outpainter: Outpainter | None = None
    inpainter: Inpainter | None = None
    depth: DepthProvider | None = None
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, config: ReconstructConfig, access: ModelAccess, seed: int = 0) -> Priors:
        """The priors that a configuration names, and a depth estimator if one is on this machine.

        Args:
            config: names and constants.
            access: how learned priors get at their weights.
            seed: of what they draw.

        Raises:
            Unknown: no such prior.
            Unavailable: one that was asked for by name has no weights here.
        """
        outpainter, outpainter_note = choose_outpainter(config.canvas.outpainter, access, config.diffusion, seed)
        inpainter, inpainter_note = choose_inpainter(config.repair.inpainter, access, config.diffusion, seed)
        estimator, depth_note = choose_depth_estimator(access)
        notes = (outpainter_note, inpainter_note, depth_note)
        return cls(outpainter, inpainter, estimator, tuple(dict.fromkeys(note for note in notes if note)))

    def using(self, provider: DepthProvider) -> Priors:
        """The same with the provider of the input's depth, where that can look at a new picture."""
        if isinstance(provider, AutoDepth) and provider.chosen is not None:
            provider = provider.chosen
        return replace(self, depth=provider) if provider.name in _ESTIMATORS else self

    def to_json(self) -> dict[str, Any]:
        """Names and notes, for the record."""
        parts = {"outpainter": self.outpainter, "inpainter": self.inpainter, "depth": self.depth}
        return {key: part.name if part else "none" for key, part in parts.items()} | {"notes": list(self.notes)}


def choose_inpainter(
    name: str, access: ModelAccess, config: DiffusionConfig | None = None, seed: int = 0
) -> tuple[Inpainter | None, str]:
    """The inpainter of that name (None for ``none``), and a note.

    ``auto`` is Stable Diffusion 1.5 where its weights are on this machine, else ``classical``: it never downloads
    four gigabytes on its own. Asked for by name, ``sd15`` does.

    Raises:
        Unknown: no such inpainter.
        Unavailable: ``sd15`` was asked for by name, and its weights are not to be had.
    """
    if name == "none":
        return None, ""
    name, note = _resolved(name, access, "classical")
    if name == "sd15":
        return DiffusionInpainter(access, config or DiffusionConfig(), seed), note
    if name == "classical":
        return ExemplarInpainter(seed=seed), note
    return INPAINTERS.get(name)(), note


def choose_outpainter(
    name: str, access: ModelAccess, config: DiffusionConfig | None = None, seed: int = 0
) -> tuple[Outpainter | None, str]:
    """The outpainter of that name (None for ``none``), and a note. Errors as for `choose_inpainter`.

    ``auto`` is Stable Diffusion 1.5 where its weights are, else ``mean``: what lay beyond cropped pictures came back
    closer with it than with exemplars (``classical``), which also take several times as long.
    """
    if name == "none":
        return None, ""
    name, note = _resolved(name, access, "mean")
    if name == "sd15":
        return DiffusionOutpainter(access, config, seed), note
    if name == "classical":
        return ClassicalOutpainter(seed=seed), note
    return OUTPAINTERS.get(name)(), note


def choose_depth_estimator(access: ModelAccess) -> tuple[DepthProvider | None, str]:
    """Who estimates the depth of what was in- or outpainted: a network on this machine; nothing is downloaded."""
    reasons = []
    for model, provider in ((DEPTH_PRO, DepthProDepth), (DEPTH_ANYTHING_V2_SMALL, DepthAnythingDepth)):
        try:
            locate(model, access.offline())
        except Unavailable as error:
            reasons.append(error.given)
            continue
        return provider(access), ""
    return None, "; ".join(reasons)


def _resolved(name: str, access: ModelAccess, without_weights: str) -> tuple[str, str]:
    """What ``auto`` comes to, and why not more; that the weights of ``sd15`` are there is seen to now."""
    if name == "sd15":
        locate(SD15_INPAINTING, access)
    if name != "auto":
        return name, ""
    try:
        locate(SD15_INPAINTING, access.offline())
    except Unavailable as error:
        return without_weights, error.given
    return "sd15", ""
