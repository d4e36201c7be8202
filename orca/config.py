"""Every constant of the method, as frozen dataclasses; a preset is a named instance.

Marks in the comments: P = stated by the paper, I = from the base representation (IRIS), O = our choice.
Defaults are those of the `draft` preset unless a comment says otherwise.
"""

from __future__ import annotations

import difflib
import math
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

from orca.errors import BadInput, Unknown
from orca.priors.diffusion_config import DiffusionConfig
from orca.repair.generative_config import GenerativeConfig
from orca.repair.rules import RepairRules

__all__ = [
    "PRESETS",
    "CanvasConfig",
    "DeformConfig",
    "GrowthConfig",
    "HashConfig",
    "PlacementConfig",
    "PlanarConfig",
    "ReconstructConfig",
    "RenderConfig",
    "RepairConfig",
    "TrainConfig",
    "get_preset",
]

MEASURED_EDGE_RATIO = 1.05
"""O. Two measured depths further apart than this ratio are two surfaces; estimated depth needs more room for error."""


@dataclass(frozen=True)
class HashConfig:
    """Multi-resolution hash encoding (I)."""

    levels: int = 16
    log2_table_size: int = 19
    coarsest_resolution: int = 16
    finest_resolution: int = 8192
    initial: float = 1e-3


@dataclass(frozen=True)
class RenderConfig:
    """How rays meet anchors and how hits become colour.

    Attributes:
        chi2: a ray hits an anchor iff its squared Mahalanobis distance is at most this (I: 6.25).
        max_hits: hits kept per ray, nearest first; more are counted as overflow, never silently lost (I).
        near: hits nearer than this are ignored, in scene units.
        decode: "per_hit" decodes every hit (I, P); "layered" decodes each surface once (O).
        window: with "per_hit", aggregate over this many neighbours on either side in depth order (I: 2);
            -1 aggregates over the hit's whole depth layer (O).
        layer_gap_sigmas: consecutive hits nearer than this many sigmas along the ray are one surface (O) ...
        layer_gap_relative: ... or nearer than this share of their depth (O).
        background: colour behind everything, 0..1 grey.
        backdrop: what a finished picture shows where no anchor is: the colours of its "surroundings" (O), or the
            "plain" background.
    """

    chi2: float = 6.25
    max_hits: int = 64
    near: float = 1e-3
    decode: Literal["layered", "per_hit"] = "layered"
    window: int = -1
    layer_gap_sigmas: float = 2.0
    layer_gap_relative: float = 0.05
    background: float = 0.0
    backdrop: Literal["surroundings", "plain"] = "surroundings"


@dataclass(frozen=True)
class TrainConfig:
    """Gradient training (learning rates: I; batch: O)."""

    batch_rays: int = 4096
    lr_field: float = 1e-2
    lr_field_final: float = 1e-4
    lr_means: float = 1e-5
    lr_log_variances: float = 5e-5
    lr_quaternions: float = 1e-3
    lr_opacity: float = 1e-3
    adam_eps: float = 1e-15
    random_background: bool = True  # O: with a fixed one the plane stays see-through
    eval_every: int = 1000  # P
    min_gain_db: float = 0.03  # P
    patience: int = 4  # P
    smoothing: float = 0.5  # O: weight of the newest PSNR in the running mean that early stopping watches


@dataclass(frozen=True)
class CanvasConfig:
    """How far the outpainted image reaches beyond the original.

    Attributes:
        outpainter: name in the registry of outpainters, "none", or "auto": "sd15" (P) where its weights are on this
            machine, else "mean" (O).
        max_scale: the canvas is at most this many times the image's size; how much of it is used follows
            from how far the trajectory looks outside (O).
    """

    outpainter: str = "auto"
    max_scale: float = 2.5


@dataclass(frozen=True)
class PlacementConfig:
    """Where the anchors go (O).

    Attributes:
        kind: "growth" places them by need and by residual (`orca.stages.growth`), "quadtree" by need at once, "grid"
            on a regular grid (P).
        margin_importance: how much an error in the outpainted margin counts against one in the original.
        margin_cell: side of the largest cells in the outpainted margin, in pixels: a power of two, at least 8.
        edge_ratio: neighbouring depths further apart than this ratio are a depth edge.
        edge_weight: how much a cell across a depth edge costs, in units of the local colour variance (at 0.5 the input
            view, visible content and a second view lose, at 0 the input view; measured) ...
        edge_floor: ... to which this is added, since silhouettes move in novel views whatever their contrast.
    """

    kind: Literal["growth", "quadtree", "grid"] = "growth"
    margin_importance: float = 0.25
    margin_cell: int = 16
    edge_ratio: float = 1.1
    edge_weight: float = 0.1
    edge_floor: float = 0.005


@dataclass(frozen=True)
class PlanarConfig:
    """Stage 1 (P: iterations; O: the rest).

    Attributes:
        anchors_per_pixel: anchors per pixel of the original image; 0.25 is 65,536 at 512x512. Those in the outpainted
            margin come on top, except where a quadtree is placed at once: there they are within that number.
        placement: where they go.
        margin_spacing: grid spacing outside the original, in units of the spacing inside ("grid" only).
        kappa: standard deviation of an anchor over the grid spacing.
        thickness: standard deviation along the plane's normal over that in the plane.
        opacity_logit: initial omega (I: 1; O: 5, opaque surfaces).
        density: sigma that the analytic initialisation gives every anchor.
        initialisation: "closed_form" solves for the features (METHOD.md 1.2), "random" is the paper's.
        colour_clip: colours are kept this far from 0 and 1 before the logit.
        gauss_newton_steps, cg_steps: outer and inner steps of the closed-form solve.
        max_iterations: gradient steps at most (P: 30,000).
        freeze_geometry: keep means and covariances fixed in stage 1.
        use_direction: feed the view direction to the colour decoder (I: yes; O: off while there is one camera).
    """

    anchors_per_pixel: float = 0.25
    placement: PlacementConfig = field(default_factory=PlacementConfig)
    margin_spacing: float = 2.0
    kappa: float = 0.5
    thickness: float = 0.3
    opacity_logit: float = 5.0
    density: float = 15.0
    initialisation: Literal["closed_form", "random"] = "closed_form"
    colour_clip: float = 2e-3
    gauss_newton_steps: int = 3
    cg_steps: int = 6
    max_iterations: int = 0
    freeze_geometry: bool = True
    use_direction: bool = False


@dataclass(frozen=True)
class GrowthConfig:
    """Growth by residual, and when it stops (O).

    Attributes:
        target_psnr: grow until the input view is reproduced this well, in dB.
        max_anchors: grow to at most so many anchors, margin included; what repair inserts comes on top.
        max_inside: grow to so many anchors inside the original; those of the margin come on top. Presets set it, unless
            one of the other limits is given.
        margin_share: the margin's anchors at most, as a share of ``max_inside``.
        price: grow until a thousand more anchors gain less than this, in dB: what anchors cost, in bytes as in
            seconds, grows with their number, so a gain per anchor is what can be weighed against it.
        start: anchors at the start, as a share of the count allowed.
        start_target: the same, as a share of what target or price seem to need.
        growth: how many times more anchors a round to a count ends with, at most: small rounds place better.
        growth_open: the same where there is no count (its square towards a target).
        solver_steps, cg_steps: outer and inner steps of a round, warm started; the first takes twice as many outer.
        min_gain_db, patience: stop after so many rounds that gain less (P: 0.03 dB, 4 evaluations).
    """

    target_psnr: float | None = None
    max_anchors: int | None = None
    max_inside: int | None = None
    margin_share: float = 0.15
    price: float | None = None
    start: float = 0.7
    start_target: float = 0.8
    growth: float = 1.15
    growth_open: float = 1.25
    solver_steps: int = 1
    cg_steps: int = 3
    min_gain_db: float = 0.03
    patience: int = 4

    def __post_init__(self) -> None:
        """Raises `BadInput` for limits that are not positive and finite."""
        for name in ("target_psnr", "max_anchors", "price"):
            value = getattr(self, name)
            if value is not None and not (0 < value < math.inf):
                raise BadInput(f"{name} {value}", "a positive, finite number", "give another one, or leave it out")

    @property
    def wanted(self) -> bool:
        """Whether a limit other than the preset's count is given."""
        return not (self.target_psnr is None and self.max_anchors is None and self.price is None)


@dataclass(frozen=True)
class DeformConfig:
    """Stage 2.

    Attributes:
        lifting: "metric" puts every mean at the provider's depth; "relative" is the paper's formula.
        strength: lambda of the paper's formula (O).
        far_quantile, near_quantile: robust quantiles of inverse depth (O).
        epsilon: guards the inverse depth (P: a small positive constant).
        denoise_depth: smooth speckle on surfaces, edges left standing (O).
        sharpen_depth: move depths halfway between two surfaces to the nearer of the two, so that no anchor
            floats between foreground and background (O).
        edge_ratio: two depths further apart than this ratio, within the window, are two surfaces (O).
        rim_ratio, rim_extent: an anchor that reaches over pixels deeper by this ratio is shrunk until it does not,
            to no less than this share; the ratio is that of two layers, so nothing covers what it is not one
            surface with (O).
        rim_clearance: how many pixels before the centre of the nearest such pixel it ends (O).
        follow_slope: tilt and stretch each Gaussian with the surface it lies on (O).
        max_slope: largest relative depth change per unit of image tangent that is still one surface (O).
        max_iterations: fine-tuning steps at most (P: 20,000).
        arm_after: early stopping is enabled after this many steps (P: 10,000).
    """

    lifting: Literal["metric", "relative"] = "metric"
    strength: float = 0.4
    far_quantile: float = 0.02
    near_quantile: float = 0.98
    epsilon: float = 1e-6
    denoise_depth: bool = True
    sharpen_depth: bool = True
    edge_ratio: float = 1.12
    rim_ratio: float = 1.05
    rim_extent: float = 0.5
    rim_clearance: float = 0.25
    follow_slope: bool = True
    max_slope: float = 4.0
    max_iterations: int = 0
    arm_after: int = 10_000


@dataclass(frozen=True)
class RepairConfig:
    """Stage 3.

    Attributes:
        enabled: whether to repair at all.
        views: how many views of the trajectory are watched, evenly spaced (O; 0 watches all of them).
        rules: thresholds of the paper and ours, for 512x512 renders.
        fill: "paper" copies donors, "smooth" continues the background's colour, "structure" its texture too (O).
        inpainter: who completes large regions: a name of `orca.priors.choose.INPAINTER_CHOICES` (P: "sd15"; "auto" is
            that where its weights are, else "classical").
        spread: where a repair's anchors go: "need" gives one to several pixels where more would be worth less than in
            the image (O), "even" one to every pixel (P).
        generative: how a large region is completed.
    """

    enabled: bool = True
    views: int = 25
    rules: RepairRules = field(default_factory=lambda: RepairRules(max_steps=3, max_iterations=150, enough=0.004))
    fill: Literal["paper", "smooth", "structure"] = "structure"
    inpainter: str = "auto"
    spread: Literal["need", "even"] = "need"
    generative: GenerativeConfig = field(default_factory=GenerativeConfig)


@dataclass(frozen=True)
class ReconstructConfig:
    """The whole method."""

    name: str = "draft"
    hash: HashConfig = field(default_factory=HashConfig)
    render: RenderConfig = field(default_factory=RenderConfig)
    train: TrainConfig = field(default_factory=TrainConfig)
    canvas: CanvasConfig = field(default_factory=CanvasConfig)
    planar: PlanarConfig = field(default_factory=PlanarConfig)
    growth: GrowthConfig = field(default_factory=GrowthConfig)
    prune: bool = True  # O: leave out the anchors that no view of the trajectory reaches
    deform: DeformConfig = field(default_factory=DeformConfig)
    repair: RepairConfig = field(default_factory=RepairConfig)
    diffusion: DiffusionConfig = field(default_factory=DiffusionConfig)
    schema_version: int = 1

    def to_json(self) -> dict[str, Any]:
        """Plain data with every resolved value."""
        return asdict(self)

    def trusting_depth(self) -> ReconstructConfig:
        """The same configuration for measured depth: neither smoothed nor sharpened, and smaller steps are edges."""
        ratio = min(self.deform.edge_ratio, MEASURED_EDGE_RATIO)
        return replace(self, deform=replace(self.deform, denoise_depth=False, sharpen_depth=False, edge_ratio=ratio))

    def with_lifting(self, lifting: Literal["metric", "relative"]) -> ReconstructConfig:
        """The same configuration with another lifting."""
        return replace(self, deform=replace(self.deform, lifting=lifting))


_DRAFT = ReconstructConfig()
_QUALITY = replace(_DRAFT, name="quality", planar=replace(_DRAFT.planar, anchors_per_pixel=1.0))
_PAPER = ReconstructConfig(
    name="paper",
    render=RenderConfig(decode="per_hit", window=2, backdrop="plain"),
    planar=PlanarConfig(
        anchors_per_pixel=1.0,
        placement=PlacementConfig(kind="grid"),
        margin_spacing=1.0,
        initialisation="random",
        opacity_logit=1.0,
        max_iterations=30_000,
        use_direction=True,
    ),
    deform=DeformConfig(
        lifting="relative", denoise_depth=False, sharpen_depth=False, follow_slope=False, max_iterations=20_000
    ),
    repair=RepairConfig(views=0, rules=RepairRules(), fill="paper", spread="even"),
)

PRESETS: dict[str, ReconstructConfig] = {preset.name: preset for preset in (_DRAFT, _QUALITY, _PAPER)}


def get_preset(name: str) -> ReconstructConfig:
    """The preset of that name; raises `Unknown` with the nearest name otherwise."""
    if name not in PRESETS:
        near = difflib.get_close_matches(name, PRESETS, n=1)
        fix = f"did you mean '{near[0]}'?" if near else "choose one of the list"
        raise Unknown(f"unknown preset '{name}'", ", ".join(PRESETS), fix)
    return PRESETS[name]
