"""Methods that a user brings: ``[NAME=]KIND:PATH`` on the command line, beside the names of the registry.

| kind | what lies under PATH, per scene of the data set |
|---|---|
| ``frames`` | ``<scene>/*.png`` or ``*.jpg`` and a camera file |
| ``video`` | ``<scene>.mp4`` with ``<scene>.json``, or ``<scene>/`` with one mp4 and a camera file |
| ``ply`` | ``<scene>.ply``, or ``<scene>/`` with one ply: 3D Gaussian splats, rendered here |
| ``vistadream-video`` | the videos that a VistaDream run writes (option ``stage=refine`` or ``coarse``) |
| ``vistadream-scene`` | ``<scene>/scene.pth`` and its like (same option), rendered here |
| ``orca-scene`` | ``<scene>.safetensors`` or ``<scene>/scene.safetensors``, rendered here |

NAME is the row of the table and a folder of the run; KIND-FOLDER when left out.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from bench.adapters.points import is_point, parse_point, split_point
from orca.errors import BadInput
from orca.priors.spec import PriorSpec, parse_spec
from orca.registry import Registry

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bench.adapters.adapter import Adapter

__all__ = [
    "KINDS",
    "KIND_DESCRIPTIONS",
    "ExternalSpec",
    "MethodRegistry",
    "is_external",
    "open_methods",
    "parse_external",
]

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,79}")

KINDS: Registry[Callable[[ExternalSpec], Adapter]] = Registry(
    "kind of method",
    {
        "frames": "bench.adapters.frames:open_frames",
        "video": "bench.adapters.frames:open_video",
        "ply": "bench.adapters.splat_methods:open_ply",
        "vistadream-video": "bench.adapters.vistadream:open_run_videos",
        "vistadream-scene": "bench.adapters.splat_methods:open_vistadream_scene",
        "orca-scene": "bench.adapters.orca_scene:open_orca_scene",
    },
)

KIND_DESCRIPTIONS = {
    "frames": "frames:PATH with <scene>/*.png and a camera file each",
    "video": "video:PATH with <scene>.mp4 and <scene>.json (cameras)",
    "ply": "ply:PATH with <scene>.ply, 3D Gaussian splats, rendered here",
    "vistadream-video": "vistadream-video:PATH with the videos of a VistaDream run; ?stage=coarse for the others",
    "vistadream-scene": "vistadream-scene:PATH with <scene>/scene.pth of a VistaDream run, rendered here",
    "orca-scene": "orca-scene:PATH with <scene>.safetensors, rendered here",
}

T = TypeVar("T")


@dataclass(frozen=True)
class ExternalSpec:
    """A parsed ``[NAME=]KIND:PATH[?option=value]``.

    Attributes:
        text: as given.
        name: the row's name.
        kind: one of `KINDS`.
        path: the folder.
        options: the rest, checked by the kind.
    """

    text: str
    name: str
    kind: str
    path: Path
    options: dict[str, str] = field(default_factory=dict)

    def choice(self, key: str, allowed: tuple[str, ...], default: str) -> str:
        """The value of the one option that this kind has; raises `Unknown` for another option."""
        spec = PriorSpec(self.kind, self.path, self.options)
        spec.allow(key)
        return spec.choice(key, allowed, default)

    def no_options(self) -> None:
        """Raise `Unknown` if any option is given."""
        PriorSpec(self.kind, self.path, self.options).allow()


def is_external(text: str) -> bool:
    """Whether a method's name has the form of `ExternalSpec`."""
    return ":" in text


def parse_external(text: str) -> ExternalSpec:
    """Read ``[NAME=]KIND:PATH[?option=value]``; looks at no file.

    Raises:
        Unknown: no such kind.
        BadInput: no path, or a NAME that cannot be a folder of the run.
    """
    head, _, _ = text.partition(":")
    given, equals, _ = head.partition("=")
    spec = parse_spec(text[len(given) + 1 :] if equals else text)
    kind, path = KINDS.check(spec.name), spec.need_path()
    default = f"{kind}-{re.sub('[^A-Za-z0-9._-]+', '-', path.expanduser().resolve().name).strip('-.') or 'root'}"
    name = given if equals else default[:80]
    if not _NAME.fullmatch(name):
        raise BadInput(
            f"the name '{name}' of method '{text}'",
            "letters, digits, dot, dash and underscore, at most 80, no dot first",
            "write it as NAME=KIND:PATH with such a NAME",
        )
    return ExternalSpec(text, name, kind, path.expanduser(), spec.options)


class MethodRegistry(Registry[T]):
    """The named methods, points of them, and those that a user brings: any process can open each by its text."""

    def check(self, name: str) -> str:
        """As `Registry.check`; the text of a point or of an external method is checked for its form."""
        if is_external(name):
            parse_external(name)
            return name
        if is_point(name):
            super().check(split_point(name)[0])
            return name
        return super().check(name)

    def get(self, name: str) -> T:
        """As `Registry.get`; also opens points of `bench.adapters.points` and ``[NAME=]KIND:PATH``.

        Raises `BadInput` for a path that is no folder.
        """
        if is_point(name):
            return parse_point(name)  # type: ignore[no-any-return]
        if not is_external(name):
            return super().get(name)
        spec = parse_external(name)
        if spec.name in self:
            raise BadInput(
                f"the name '{spec.name}' of method '{name}'",
                "a name that no built-in method has",
                "choose another NAME",
            )
        if not spec.path.is_dir():
            raise BadInput(f"method '{name}': no folder {spec.path}", "a folder with one entry a scene", "check PATH")
        return KINDS.get(spec.kind)(spec)  # type: ignore[return-value]


def open_methods(names: Sequence[str], registry: Registry[T]) -> dict[str, T]:
    """Row name -> method, in order.

    Raises:
        Unknown: no such method or kind.
        BadInput: two methods of one name, or what `MethodRegistry.get` raises.
    """
    opened: dict[str, T] = {}
    for name in names:
        row = parse_external(name).name if is_external(name) else name
        if row in opened:
            raise BadInput(f"two methods named '{row}'", "one row a name", "give one of them another: NAME=KIND:PATH")
        opened[row] = registry.get(name)
    return opened
