"""The constants of stage 3, and which components may be completed generatively (paper, "Disocclusion Repair")."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

from orca.errors import BadInput
from orca.repair.components import Component

__all__ = ["REFERENCE_SIDE", "Decision", "RepairRules", "decide", "order"]

REFERENCE_SIDE = 512
"""The paper states its pixel thresholds for renders of 512 x 512."""


@dataclass(frozen=True)
class RepairRules:
    """Every constant of disocclusion repair; P marks the paper's value, O a choice of this project.

    Attributes:
        alpha_threshold: O. A pixel with less accumulated alpha is missing.
        closing_radius: O. Radius in pixels of the closing that joins a sieve of missing pixels into one region.
        edge_alpha: O. Beside a missing region, pixels with less accumulated alpha than this belong to it ...
        edge_reach: O. ... up to so many pixels away.
        bridge: O. Missing pieces up to this many pixels apart are one component.
        min_component_area: O. Components of fewer pixels are not worth a repair.
        generative_min_area: P. Generative completion needs at least this many pixels.
        generative_min_fill: P. ... and this share of the bounding box.
        generative_min_side: P. ... and this many pixels along the shorter side of the bounding box.
        generative_budget: P. ... and no more than this many generative completions a scene.
        ring_inner: P. Donors are at least this far from the component, in pixels: nearer ones are blended edges.
        ring_outer: P. Donors are at most this far from the component, in pixels.
        smooth_ring_inner: O. The same as ring_inner for the "smooth" fill, which tells foreground from background
            per pixel and gains 1.0 dB from touching the hole (Motorcycle's holes).
        context: O. Texture for the "structure" fill is looked for within so many pixels of the component.
        patch_radius: O. Its patches have 2 patch_radius + 1 pixels a side.
        patch_matches: O. How many matches of a patch are averaged. A sample count: never scaled.
        detail_gain: O. Share of the donors' texture that the "smooth" fill mirrors into the hole; 0 is a pure membrane.
        min_donors: P. With fewer donors the fill is by nearest neighbour. A sample count: never scaled.
        donor_percentile: P. Donors are the ring's pixels at or beyond this percentile of its depth.
        covariance_scale: P. Inserted Gaussians have their covariance multiplied by this.
        min_opacity: P. Smallest opacity of an inserted Gaussian.
        max_anchors: P. Most anchors that one repair inserts.
        max_steps: P. Most optimisation steps that one repair takes.
        max_iterations: O. Most repairs of a scene.
        enough: O. No more are made where no view misses as large a share of its pixels as this; 0 goes on until only
            components under ``min_component_area`` are left.
    """

    alpha_threshold: float = 0.8
    closing_radius: int = 1
    edge_alpha: float = 0.97
    edge_reach: int = 2
    bridge: int = 4
    min_component_area: int = 16
    generative_min_area: int = 9000
    generative_min_fill: float = 0.45
    generative_min_side: int = 64
    generative_budget: int = 2
    ring_inner: int = 3
    ring_outer: int = 28
    smooth_ring_inner: int = 1
    detail_gain: float = 0.3
    context: int = 84
    patch_radius: int = 6
    patch_matches: int = 30
    min_donors: int = 32
    donor_percentile: float = 78.0
    covariance_scale: float = 1.7
    min_opacity: float = 0.9
    max_anchors: int = 5000
    max_steps: int = 24
    max_iterations: int = 64
    enough: float = 0.0

    def __post_init__(self) -> None:
        bounds: dict[str, tuple[float, float]] = {
            "alpha_threshold": (0.0, 1.0),
            "closing_radius": (0, math.inf),
            "edge_alpha": (0.0, 1.0),
            "edge_reach": (0, math.inf),
            "bridge": (0, math.inf),
            "min_component_area": (1, math.inf),
            "generative_min_area": (1, math.inf),
            "generative_min_fill": (0.0, 1.0),
            "generative_min_side": (1, math.inf),
            "generative_budget": (0, math.inf),
            "ring_inner": (0, math.inf),
            "ring_outer": (max(self.ring_inner, self.smooth_ring_inner) + 1, math.inf),
            "smooth_ring_inner": (0, math.inf),
            "detail_gain": (0.0, 1.0),
            "context": (self.ring_outer, math.inf),
            "patch_radius": (1, math.inf),
            "patch_matches": (1, math.inf),
            "min_donors": (1, math.inf),
            "donor_percentile": (0.0, 100.0),
            "covariance_scale": (1e-6, math.inf),
            "min_opacity": (0.0, 1.0),
            "max_anchors": (1, math.inf),
            "max_steps": (0, math.inf),
            "max_iterations": (0, math.inf),
            "enough": (0.0, 1.0),
        }
        for name, (low, high) in bounds.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise BadInput(
                    f"repair rule {name} = {value!r}",
                    f"at least {low:g}" if math.isinf(high) else f"{low:g} to {high:g}",
                    f"change {name} in the repair section of the configuration",
                )

    def scaled(self, width: int, height: int) -> RepairRules:
        """The rules for renders of another size.

        Areas scale with ``width * height / 512^2``, sides and radii with its square root; both are rounded to whole
        pixels, at least 1 (closing and edge keep theirs: a sieve has holes of a pixel at every size). Shares,
        percentiles, counts of samples, anchors, steps and the budget stay. At 512 x 512 nothing changes.
        """
        if width < 1 or height < 1:
            raise BadInput(f"a render of {width}x{height} pixels", "a positive size", "check the camera")
        area = width * height / REFERENCE_SIDE**2
        side = math.sqrt(area)

        def whole(value: float) -> int:
            return max(1, math.floor(value + 0.5))

        inner = whole(self.ring_inner * side) if self.ring_inner else 0
        smooth_inner = whole(self.smooth_ring_inner * side) if self.smooth_ring_inner else 0
        outer = max(max(inner, smooth_inner) + 1, whole(self.ring_outer * side))
        return replace(
            self,
            bridge=whole(self.bridge * side) if self.bridge else 0,
            min_component_area=whole(self.min_component_area * area),
            generative_min_area=whole(self.generative_min_area * area),
            generative_min_side=whole(self.generative_min_side * side),
            ring_inner=inner,
            ring_outer=outer,
            smooth_ring_inner=smooth_inner,
            context=max(outer, whole(self.context * side)),
            patch_radius=max(2, whole(self.patch_radius * side)),
        )

    def to_json(self) -> dict[str, Any]:
        """Field name to value, for the ledger and the resolved configuration."""
        return asdict(self)


@dataclass(frozen=True)
class Decision:
    """How a component is repaired.

    Attributes:
        kind: "local" (from the surrounding background) or "generative" (inpainted).
        rule: name of the first rule that decided: the field of `RepairRules` that failed, or "all_hold".
        reason: the same as a sentence with the numbers compared.
    """

    kind: Literal["local", "generative"]
    rule: str
    reason: str


def decide(component: Component, budget_left: int, rules: RepairRules) -> Decision:
    """Local or generative: generative only if area, fill, shorter side and budget all allow it.

    Args:
        component: the missing region.
        budget_left: generative completions that the scene may still make.
        rules: thresholds for this render size (`RepairRules.scaled`).
    """
    if component.area < rules.generative_min_area:
        return Decision("local", "generative_min_area", f"{component.area} px < {rules.generative_min_area} px")
    if component.fill < rules.generative_min_fill:
        reason = f"fills {component.fill:.2%} of its bounding box < {rules.generative_min_fill:.2%}"
        return Decision("local", "generative_min_fill", reason)
    if component.short_side < rules.generative_min_side:
        reason = f"shorter side {component.short_side} px < {rules.generative_min_side} px"
        return Decision("local", "generative_min_side", reason)
    if budget_left < 1:
        return Decision("local", "generative_budget", f"the budget of {rules.generative_budget} is spent")
    return Decision("generative", "all_hold", f"large and compact, {budget_left} of {rules.generative_budget} left")


def order(components: Sequence[Component], budget_left: int, rules: RepairRules) -> list[tuple[Component, Decision]]:
    """Decide every component and put local ones first, each kind in the order given (`connected_components`: by size).

    The budget is counted down along the list, so no more than ``budget_left`` decisions are generative.
    """
    decided: list[tuple[Component, Decision]] = []
    for component in components:
        decision = decide(component, budget_left, rules)
        budget_left -= decision.kind == "generative"
        decided.append((component, decision))
    return sorted(decided, key=lambda pair: pair[1].kind == "generative")
