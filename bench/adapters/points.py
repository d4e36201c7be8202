"""Points of a sweep: ORCA with a few constants changed, as a method whose name says which.

``orca@anchors=16384+repair=off`` is `orca` with 16,384 anchors and no repair. Such a name is given wherever a method's
is, and its results lie in a folder of that name; so they are resumed, verified and tabulated as any method's are.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from orca.errors import BadInput, Unknown

if TYPE_CHECKING:
    from orca.config import ReconstructConfig

__all__ = ["KNOBS", "SWEEP", "Knob", "Overrides", "is_point", "parse_point", "split_point"]

SWEEP = (
    "orca@anchors=16384+repair=off",
    "orca@canvas=off+repair=off",
    "orca@repair=off",
    "orca@hits=16+repair=off",
    "orca@anchors=16384+decode=per_hit+repair=off",
    "orca@iterations=100+repair=off",
    "orca@placement=grid+repair=off",
    "orca@price=0.1+repair=off",
    "orca@target_psnr=40+repair=off",
    "orca@anchors=131072+repair=off",
    "orca@preset=quality",
    "orca",
)
"""The points of ORCA that ``bench sweep`` runs unless told otherwise.

Repair takes the most time and changes neither the input view nor what the others compare, so only two points have it.
"""

_MOST = 10_000_000


def is_point(text: str) -> bool:
    """Whether a method's name has the form ``BASE@...`` (a path of `bench.adapters.external` may hold an @ too).

    Raises `BadInput` for what is left of a point whose changes were joined by commas, which separate methods.
    """
    if text.partition("=")[0] in KNOBS and "=" in text and ":" not in text:
        raise BadInput(
            f"'{text}' among the methods",
            "changes of one point joined by +",
            f"write it as orca@anchors=16384+{text}",
        )
    return "@" in text and ":" not in text


def split_point(text: str) -> tuple[str, Overrides]:
    """Base and overrides of a point's name, checked by `Overrides.parse`."""
    base, _, changes = text.partition("@")
    return base, Overrides.parse(changes, text)


@dataclass(frozen=True)
class Knob:
    """One constant, or a few that belong together, that a point may change.

    Attributes:
        allowed: which values, in words.
        read: the value of a text; raises `ValueError` for one that is not allowed.
        change: (configuration, value, pixels of the input image or None where unknown) -> configuration.
        what: what it is, for people.
    """

    allowed: str
    read: Callable[[str], Any]
    change: Callable[[ReconstructConfig, Any, int | None], ReconstructConfig]
    what: str


@dataclass(frozen=True)
class Overrides:
    """What a point changes.

    Attributes:
        values: (knob, value as read), in the order given.
    """

    values: tuple[tuple[str, Any], ...]

    @staticmethod
    def parse(changes: str, name: str) -> Overrides:
        """Read ``key=value+key=value``; ``name`` is the whole name, for the errors.

        Raises:
            Unknown: no such key.
            BadInput: none, twice the same, or a value that its knob does not allow.
        """
        values: dict[str, Any] = {}
        for change in changes.split("+"):
            key, equals, text = (part.strip() for part in change.partition("="))
            if not equals or not text or key in values:
                raise BadInput(
                    f"'{change}' in method '{name}'" + (" for the second time" if key in values else ""),
                    f"BASE@key=value+key=value, each key once: {', '.join(KNOBS)}",
                    "write it as orca@anchors=16384+repair=off",
                )
            if key not in KNOBS:
                near = difflib.get_close_matches(key, KNOBS, n=1, cutoff=0.5)
                fix = f"did you mean '{near[0]}'?" if near else "choose one key of the list"
                raise Unknown(f"unknown key '{key}' in method '{name}'", ", ".join(KNOBS), fix)
            values[key] = _read(key, text, name)
        return Overrides(tuple(values.items()))

    @property
    def preset(self) -> str | None:
        """The preset that the point starts from; None for the run's."""
        return dict(self.values).get("preset")

    def applied(self, config: ReconstructConfig, pixels: int | None = None) -> ReconstructConfig:
        """The configuration with the changes made.

        Args:
            config: the preset that the point starts from.
            pixels: of the input image; without it a number of anchors is left as the preset has it.
        """
        for key, value in self.values:
            config = KNOBS[key].change(config, value, pixels)
        return config

    def to_json(self) -> dict[str, Any]:
        """Knob -> value."""
        return dict(self.values)


def parse_point(text: str) -> Any:
    """The method behind a point's name.

    Raises:
        Unknown: no such base or key.
        BadInput: a value that is not allowed.
    """
    from bench.adapters import orca

    bases = {method.name: method for method in (orca.ORCA, orca.ORCA_PAPER)}
    base = text.partition("@")[0]
    if base not in bases:
        raise Unknown(
            f"points of method '{base}' in '{text}'", ", ".join(bases), "write it as orca@anchors=16384+repair=off"
        )
    return replace(bases[base], name=text, overrides=split_point(text)[1])


def _read(key: str, text: str, name: str) -> Any:
    try:
        return KNOBS[key].read(text)
    except ValueError as error:
        raise BadInput(f"{key}={text} in method '{name}'", KNOBS[key].allowed, f"give another {key}") from error


def _whole(low: int, high: int = _MOST) -> Callable[[str], int]:
    def read(text: str) -> int:
        value = int(text)
        if not low <= value <= high:
            raise ValueError(f"{value} is not from {low} to {high}")
        return value

    return read


def _one_of(*allowed: str) -> Callable[[str], str]:
    def read(text: str) -> str:
        if text not in allowed:
            raise ValueError(f"{text} is none of {allowed}")
        return text

    return read


def _positive(text: str) -> float:
    value = float(text)
    if not 0 < value < math.inf:
        raise ValueError(f"{value} is not positive and finite")
    return value


def _canvas_size(text: str) -> float:
    """Largest size of the canvas in images; 1 for none."""
    value = 1.0 if text == "off" else float(text)
    if not 1 <= value <= 10:
        raise ValueError(f"{value} is not from 1 to 10")
    return value


def _preset_name(text: str) -> str:
    from orca.config import PRESETS

    return _one_of(*PRESETS)(text)


def _anchors(config: ReconstructConfig, value: int, pixels: int | None) -> ReconstructConfig:
    if pixels is None:
        return config
    return replace(config, planar=replace(config.planar, anchors_per_pixel=value / pixels))


def _growth(name: str) -> Callable[[ReconstructConfig, Any, int | None], ReconstructConfig]:
    def change(config: ReconstructConfig, value: Any, pixels: int | None) -> ReconstructConfig:
        return replace(config, growth=replace(config.growth, **{name: value}))

    return change


def _placement(config: ReconstructConfig, value: Any, pixels: int | None) -> ReconstructConfig:
    return replace(config, planar=replace(config.planar, placement=replace(config.planar.placement, kind=value)))


def _hits(config: ReconstructConfig, value: int, pixels: int | None) -> ReconstructConfig:
    return replace(config, render=replace(config.render, max_hits=value))


def _decode(config: ReconstructConfig, value: Any, pixels: int | None) -> ReconstructConfig:
    window = 2 if value == "per_hit" else -1
    return replace(config, render=replace(config.render, decode=value, window=window))


def _iterations(config: ReconstructConfig, value: int, pixels: int | None) -> ReconstructConfig:
    """After a closed-form start only the second stage trains: it solves anew what the first ended with."""
    first = 0 if config.planar.initialisation == "closed_form" else value
    planar, deform = replace(config.planar, max_iterations=first), replace(config.deform, max_iterations=value)
    return replace(config, planar=planar, deform=deform)


def _solver_steps(config: ReconstructConfig, value: int, pixels: int | None) -> ReconstructConfig:
    return replace(config, planar=replace(config.planar, gauss_newton_steps=value))


def _repair(config: ReconstructConfig, value: str, pixels: int | None) -> ReconstructConfig:
    if value == "plain":
        return replace(config, repair=replace(config.repair, enabled=True, fill="paper"))
    return replace(config, repair=replace(config.repair, enabled=value == "on"))


def _spread(config: ReconstructConfig, value: Any, pixels: int | None) -> ReconstructConfig:
    return replace(config, repair=replace(config.repair, spread=value))


def _views(config: ReconstructConfig, value: int, pixels: int | None) -> ReconstructConfig:
    return replace(config, repair=replace(config.repair, views=value))


def _canvas(config: ReconstructConfig, value: float, pixels: int | None) -> ReconstructConfig:
    canvas = replace(config.canvas, max_scale=value)
    return replace(config, canvas=replace(canvas, outpainter="none") if value == 1 else canvas)


def _keep(config: ReconstructConfig, value: Any, pixels: int | None) -> ReconstructConfig:
    return config  # the preset is where the configuration came from


KNOBS: dict[str, Knob] = {
    "preset": Knob("a preset: draft, quality or paper", _preset_name, _keep, "what the point starts from"),
    "anchors": Knob(
        "a whole number from 64", _whole(64), _anchors, "anchors on the input image; those of its margin come on top"
    ),
    "target_psnr": Knob("a positive number", _positive, _growth("target_psnr"), "grow to this input view, in dB"),
    "max_anchors": Knob(
        "a whole number from 64", _whole(64), _growth("max_anchors"), "grow to at most so many anchors"
    ),
    "price": Knob(
        "a positive number", _positive, _growth("price"), "grow until a thousand more anchors gain less, in dB"
    ),
    "placement": Knob(
        "growth, quadtree or grid",
        _one_of("growth", "quadtree", "grid"),
        _placement,
        "where anchors go: by need and by residual, by need at once (margin within the count), or on a regular grid",
    ),
    "hits": Knob("a whole number from 1 to 4096", _whole(1, 4096), _hits, "anchors at most that a ray meets"),
    "decode": Knob(
        "layered or per_hit", _one_of("layered", "per_hit"), _decode, "each surface once, or every hit (the paper's)"
    ),
    "solver_steps": Knob("a whole number from 1 to 50", _whole(1, 50), _solver_steps, "of the closed-form start"),
    "iterations": Knob(
        "a whole number from 0", _whole(0), _iterations, "gradient steps at most, of each stage that trains"
    ),
    "repair": Knob("on, off or plain", _one_of("on", "off", "plain"), _repair, "what fills disocclusions"),
    "spread": Knob(
        "need or even", _one_of("need", "even"), _spread, "a repair's anchors: where it needs them, or one a pixel"
    ),
    "views": Knob("a whole number from 0 (all)", _whole(0), _views, "views that repair looks at"),
    "canvas": Knob(
        "off, or a number from 1 to 10", _canvas_size, _canvas, "size at most of the outpainted image, in images"
    ),
}
"""Everything that a point may change."""
