"""Thresholds of stage 3: each side of each, their scaling, the order of work."""

from __future__ import annotations

import json
from dataclasses import fields

import numpy as np
import pytest

from orca.errors import BadInput
from orca.repair.components import Component
from orca.repair.rules import RepairRules, decide, order

RULES = RepairRules()


def make(width: int, height: int, area: int) -> Component:
    """A component of ``area`` pixels that fills a box of width x height row by row."""
    mask = np.zeros(width * height, bool)
    mask[:area] = True
    return Component(mask.reshape(height, width), (0, 0, width, height))


@pytest.mark.parametrize(
    ("component", "budget_left", "kind", "rule"),
    [
        (make(100, 90, 8999), 2, "local", "generative_min_area"),
        (make(100, 90, 9000), 2, "generative", "all_hold"),
        (make(200, 125, 11225), 2, "local", "generative_min_fill"),  # 44.9 %
        (make(200, 125, 11250), 2, "generative", "all_hold"),  # 45.0 %
        (make(63, 200, 12600), 2, "local", "generative_min_side"),
        (make(200, 63, 12600), 2, "local", "generative_min_side"),
        (make(64, 200, 12800), 2, "generative", "all_hold"),
        (make(100, 100, 10000), 1, "generative", "all_hold"),
        (make(100, 100, 10000), 0, "local", "generative_budget"),
        (make(10, 1000, 10), 0, "local", "generative_min_area"),  # all four fail: the first is named
        (make(63, 1000, 9000), 0, "local", "generative_min_fill"),
    ],
)
def test_decision_on_each_side_of_each_threshold(component: Component, budget_left: int, kind: str, rule: str) -> None:
    decision = decide(component, budget_left, RULES)
    assert (decision.kind, decision.rule) == (kind, rule)


def test_budget_allows_two_generative_repairs_and_refuses_the_third() -> None:
    kinds = [decide(make(100, 100, 10000), RULES.generative_budget - used, RULES).kind for used in range(3)]
    assert kinds == ["generative", "generative", "local"]


def test_reason_states_the_numbers_compared() -> None:
    assert decide(make(100, 90, 8999), 2, RULES).reason == "8999 px < 9000 px"
    assert decide(make(200, 125, 11225), 2, RULES).reason == "fills 44.90% of its bounding box < 45.00%"


def test_local_components_come_first_and_the_budget_is_counted_down() -> None:
    big = [make(100, 100, area) for area in (10000, 9900, 9800)]
    small = make(10, 10, 50)
    ordered = order([*big, small], 2, RULES)
    assert [component.area for component, _ in ordered] == [9800, 50, 10000, 9900]
    assert [decision.kind for _, decision in ordered] == ["local", "local", "generative", "generative"]
    assert order([], 2, RULES) == []


def test_paper_values_are_the_defaults() -> None:
    stated = {
        "generative_min_area": 9000,
        "generative_min_fill": 0.45,
        "generative_min_side": 64,
        "generative_budget": 2,
        "ring_inner": 3,
        "ring_outer": 28,
        "min_donors": 32,
        "donor_percentile": 78.0,
        "covariance_scale": 1.7,
        "min_opacity": 0.9,
        "max_anchors": 5000,
        "max_steps": 24,
    }
    assert {name: getattr(RULES, name) for name in stated} == stated


def test_scaling_at_the_reference_size_changes_nothing() -> None:
    assert RULES.scaled(512, 512) == RULES


def test_scaling_worked_by_hand() -> None:
    """1024 x 1024: areas x 4, sides x 2. 512 x 128: areas / 4, sides / 2 (a half rounds up)."""
    large, small = RULES.scaled(1024, 1024), RULES.scaled(512, 128)
    assert (large.generative_min_area, large.min_component_area) == (36000, 64)
    assert (large.generative_min_side, large.ring_inner, large.ring_outer) == (128, 6, 56)
    assert (small.generative_min_area, small.min_component_area) == (2250, 4)
    assert (small.generative_min_side, small.ring_inner, small.ring_outer) == (32, 2, 14)
    scaled = {"min_component_area", "generative_min_area", "generative_min_side", "ring_inner", "ring_outer"}
    kept = {f.name for f in fields(RULES)} - scaled - {"smooth_ring_inner", "bridge", "context", "patch_radius"}
    assert all(getattr(large, name) == getattr(RULES, name) for name in kept)


def test_scaling_never_reaches_zero() -> None:
    tiny = RULES.scaled(1, 1)
    assert tiny.min_component_area == tiny.generative_min_area == tiny.generative_min_side == 1
    assert 0 < tiny.ring_inner < tiny.ring_outer
    with pytest.raises(BadInput):
        RULES.scaled(0, 512)


@pytest.mark.parametrize(
    ("name", "value"),
    [("alpha_threshold", 1.5), ("ring_outer", 3), ("min_donors", 0), ("donor_percentile", 101.0), ("max_steps", -1)],
)
def test_a_value_out_of_range_names_its_field(name: str, value: float) -> None:
    with pytest.raises(BadInput, match=name):
        RepairRules(**{name: value})  # type: ignore[arg-type]


def test_rules_are_json_and_read_back() -> None:
    assert RepairRules(**json.loads(json.dumps(RULES.to_json()))) == RULES
