"""Cases of the priors: an inpainter, an outpainter or a depth model that raises or returns nonsense."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from bench.adapters.adapter import MethodOutput, RunOptions
from bench.adapters.views import render_case
from bench.datasets.case import SceneCase
from bench.stability.case import StabilityCase
from bench.stability.outcome import DEGRADED, FALLBACK, FINISHED
from bench.stability.scenes import SIZE, make_scene, picture
from orca.camera import Camera
from orca.conventions import Float32Array, to_float
from orca.priors.choose import Priors
from orca.priors.depth import DepthEstimate
from orca.priors.hub import ModelAccess
from orca.priors.spec import PriorSpec

if TYPE_CHECKING:
    from orca.pipeline import Reconstruction

__all__ = ["PRIOR_CASES", "run_with_priors"]

Answer = Callable[[Float32Array], Float32Array]


def raises(image: Float32Array) -> Float32Array:
    """As a network does that runs out of memory or meets a shape it does not know."""
    raise RuntimeError("the model fell over")


def nan(image: Float32Array) -> Float32Array:
    """Not a number, everywhere."""
    return np.full_like(image, np.nan)


def wild(image: Float32Array) -> Float32Array:
    """Values far outside [0, 1], negative ones among them."""
    return np.asarray(np.random.default_rng(0).normal(0, 1e4, image.shape), np.float32)


def half_size(image: Float32Array) -> Float32Array:
    """Another size than was asked for."""
    return np.ascontiguousarray(image[::2, ::2])


@dataclass(frozen=True)
class FaultyInpainter:
    """Answers every hole with ``answer``."""

    answer: Answer
    name: str = "faulty"

    def inpaint(self, image: Float32Array, mask: NDArray[np.bool_]) -> Float32Array:
        """See `orca.priors.inpaint.Inpainter`."""
        return self.answer(image)


@dataclass(frozen=True)
class FaultyOutpainter:
    """Answers every margin with ``answer`` of the padded image."""

    answer: Answer
    name: str = "faulty"

    def outpaint(self, image: Float32Array, left: int, top: int, right: int, bottom: int) -> Float32Array:
        """See `orca.priors.outpaint.Outpainter`."""
        return self.answer(np.pad(image, ((top, bottom), (left, right), (0, 0)), mode="edge"))


@dataclass(frozen=True)
class FaultyDepth:
    """Answers every image with ``answer`` of its grey values."""

    answer: Answer
    name: str = "faulty"

    @classmethod
    def from_spec(cls, spec: PriorSpec) -> Self:
        """There are no options."""
        spec.allow()
        return cls(raises)

    def estimate(self, image: Float32Array, camera: Camera) -> DepthEstimate:
        """See `orca.priors.depth.DepthProvider`."""
        return DepthEstimate(self.answer(np.ascontiguousarray(image[..., 0])), "faulty", False)


@dataclass(frozen=True)
class Repeating:
    """An outpainter that repeats the border and counts as one that invents, so that depth is estimated anew."""

    name: str = "repeating"

    def outpaint(self, image: Float32Array, left: int, top: int, right: int, bottom: int) -> Float32Array:
        """See `orca.priors.outpaint.Outpainter`."""
        return np.pad(image, ((top, bottom), (left, right), (0, 0)), mode="edge")


def run_with_priors(case: SceneCase, options: RunOptions, alter: Callable[[Priors], Priors]) -> MethodOutput:
    """What the adapter of ORCA does, with other priors."""
    from orca.config import get_preset
    from orca.pipeline import reconstruct

    config = get_preset(options.preset)
    priors = alter(Priors.of(config, ModelAccess(options.weights_dir, True, options.device), options.seed))
    depth = DepthEstimate(case.depth, case.depth_source, case.depth_is_metric)
    cameras = case.eval_trajectory.cameras()
    result = reconstruct(to_float(case.image), case.camera, depth, cameras, config, priors=priors, seed=options.seed)
    return render_case(result.scene.renderer().render, case, options, {}, _fallbacks(result))


def _fallbacks(result: Reconstruction) -> tuple[str, ...]:
    """What was done instead of what a prior was asked for, in ORCA's own words."""
    repairs = [row["reason"] for row in result.ledger["repairs"] if row["rule"] == "generative_failed"]
    priors = result.record["priors"]
    beyond = [priors["outpainter_failed"]] if "outpainter_failed" in priors else []
    margin = [priors["margin_depth"]] if "failed" in priors["margin_depth"] else []
    return tuple(f"{FALLBACK}{words}" for words in dict.fromkeys([*beyond, *margin, *repairs]))


def uncovering() -> SceneCase:
    """A large near square before a wall, and a path that uncovers what it hides and looks past the frame."""
    depth = np.full((SIZE, SIZE), 1.5, np.float32)
    image = picture()
    square = np.s_[34:94, 20:80]
    depth[square], image[square] = 0.5, (200, 60, 60)
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = [0.0, -0.12, -0.2]
    return make_scene(image, depth, poses)


def _scene(folder: Path) -> SceneCase:
    return uncovering()


def _inpainter(answer: Answer) -> Callable[[Priors], Priors]:
    return lambda priors: replace(priors, inpainter=FaultyInpainter(answer), depth=None)


def _outpainter(answer: Answer) -> Callable[[Priors], Priors]:
    return lambda priors: replace(priors, outpainter=FaultyOutpainter(answer))


def _depth(answer: Answer) -> Callable[[Priors], Priors]:
    return lambda priors: replace(priors, outpainter=Repeating(), depth=FaultyDepth(answer))


def _case(
    name: str, about: str, priors: Callable[[Priors], Priors], expected: tuple[str, ...] = (DEGRADED,)
) -> StabilityCase:
    """A prior that fails must have been asked and replaced, and the result must say so."""
    return StabilityCase(name, "priors", about, expected, scene=_scene, priors=priors)


PRIOR_CASES = (
    _case("inpainter-raises", "an inpainter that raises RuntimeError", _inpainter(raises)),
    _case("inpainter-nan", "an inpainter that returns NaN", _inpainter(nan)),
    _case("inpainter-wild", "an inpainter that returns values up to 1e4", _inpainter(wild), FINISHED),
    _case("inpainter-half-size", "an inpainter that returns half the size", _inpainter(half_size)),
    _case("outpainter-raises", "an outpainter that raises RuntimeError", _outpainter(raises)),
    _case("outpainter-nan", "an outpainter that returns NaN", _outpainter(nan)),
    _case("outpainter-wild", "an outpainter that returns values up to 1e4", _outpainter(wild), FINISHED),
    _case("outpainter-half-size", "an outpainter that returns half the size", _outpainter(half_size)),
    _case("depth-model-raises", "a depth model that raises RuntimeError", _depth(raises)),
    _case("depth-model-nan", "a depth model that returns NaN", _depth(nan)),
    _case("depth-model-wild", "a depth model that returns values up to 1e4, negative ones too", _depth(wild)),
    _case("depth-model-half-size", "a depth model that returns half the size", _depth(half_size)),
)
