"""The command line of ORCA: what may be asked, and how an answer or an error is shown.

Nothing heavy is imported before a verb runs, so ``--help`` is instant.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from orca.errors import OrcaError

__all__ = ["build_parser", "main"]

_DEPTH_HELP = """depth of the image, one of:
  auto                                          the default: a depth file beside the image (its stem with .depth.png,
                                                .depth.npy, _depth.png or _depth.npy), else Depth Pro, else Depth
                                                Anything V2 Small, else heuristic; auto:N.onnx?... tries a network
                                                of yours before the heuristic
  depth-pro, depth-anything                     that network; weights from --weights-dir, or downloaded once
  file:D.png?unit=0.0001&meaning=depth          PNG or NPY; meaning: depth, inverse_depth or disparity
  onnx:N.onnx?size=384&range=255&meaning=inverse_depth    any single-input network
  heuristic                                     no network: a guess
  constant                                      a flat picture"""

# Names are said here again because the registries import much; a test compares.
OUTPAINTERS = ("auto", "none", "sd15", "classical", "mean", "mirror", "edge")
INPAINTERS = ("auto", "none", "sd15", "classical", "telea", "navier-stokes", "nearest")


def build_parser() -> argparse.ArgumentParser:
    """The parser of all verbs."""
    parser = argparse.ArgumentParser(prog="orca", description="One image to one explorable 3D scene.")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")
    _add_reconstruct(verbs)
    _add_render(verbs)
    _add_export(verbs)
    _add_view(verbs)
    info = _add_verb(verbs, "info", "say what a scene file holds")
    info.add_argument("scene", metavar="SCENE", type=Path, help="scene.safetensors")
    return parser


def _add_verb(
    verbs: argparse._SubParsersAction[argparse.ArgumentParser], name: str, text: str
) -> argparse.ArgumentParser:
    verb = verbs.add_parser(name, help=text, description=text, formatter_class=argparse.RawTextHelpFormatter)
    verb.add_argument("--json", action="store_true", help="print one JSON document on stdout")
    verb.add_argument("--debug", action="store_true", help="show the traceback of an error")
    return verb


def _add_reconstruct(verbs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    verb = _add_verb(verbs, "reconstruct", "make a scene from one image")
    verb.add_argument("image", metavar="IMAGE", type=Path)
    verb.add_argument("--out", metavar="DIR", type=Path, required=True, help="folder for the results; made if missing")
    verb.add_argument("--depth", metavar="SPEC", help=_DEPTH_HELP)
    verb.add_argument("--preset", default="draft", help="draft, quality or paper (default: draft)")
    verb.add_argument(
        "--hfov", metavar="DEG", type=float, help="horizontal field of view (default: the depth's, or 60)"
    )
    verb.add_argument(
        "--lifting", choices=("metric", "relative"), help="how depth becomes geometry (default: preset's)"
    )
    _add_growth(verb)
    _add_priors(verb)
    verb.add_argument("--seed", type=int, default=0, help="of every random draw (default: 0)")
    _add_path(verb, "spiral")


def _add_growth(verb: argparse.ArgumentParser) -> None:
    text = "grow anchors where the fit errs until the input view is reproduced this well"
    verb.add_argument("--target-psnr", metavar="DB", type=float, help=text)
    text = "grow to this many anchors at most (what repair inserts comes on top)"
    verb.add_argument("--max-anchors", metavar="N", type=int, help=text)
    text = "grow until a thousand more anchors gain less than this many dB\n"
    text += "(default: none of the three, the preset's count inside the image)"
    verb.add_argument("--price", metavar="DB", type=float, help=text)


def _add_priors(verb: argparse.ArgumentParser) -> None:
    text = "beyond the frame; auto: Stable Diffusion if its weights are here,\nelse mean (default: the preset's)"
    verb.add_argument("--outpainter", "--outpaint", choices=OUTPAINTERS, help=text)
    verb.add_argument("--inpainter", choices=INPAINTERS, help="who completes large holes (default: the preset's, auto)")
    text = "folder of weights, one folder per model (DIR/OWNER/NAME);\nnothing is downloaded then"
    verb.add_argument("--weights-dir", metavar="DIR", type=Path, help=text)
    verb.add_argument("--local-files-only", action="store_true", help="never download; the hub's cache still counts")


def _add_render(verbs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    verb = _add_verb(verbs, "render", "render a scene along a camera path into an mp4")
    verb.add_argument("scene", metavar="SCENE", type=Path, help="scene.safetensors")
    verb.add_argument("--out", metavar="MP4", type=Path, required=True, help="video to write")
    _add_path(verb, None)


def _add_export(verbs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    verb = _add_verb(verbs, "export", "write a scene as a Gaussian splat .ply for public viewers")
    verb.add_argument("scene", metavar="SCENE", type=Path, help="scene.safetensors")
    verb.add_argument("ply", metavar="PLY", type=Path, help="file to write")
    verb.add_argument("--psnr", action="store_true", help="measure how well the file agrees with the neural render")
    text = "also write a page that shows it; opened as a file, viser cannot sort, so only the\ninput view is in order: "
    text += "serve it (python -m http.server) to walk around"
    verb.add_argument("--html", metavar="FILE", type=Path, help=text)
    text = "split splats until the input view agrees this well with the neural render, twice at most (default: 35.5)"
    verb.add_argument("--target-psnr", metavar="DB", type=float, help=text)
    _add_bake(verb)


def _add_view(verbs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    verb = _add_verb(verbs, "view", "walk in a scene with a browser")
    verb.add_argument("scene", metavar="SCENE", type=Path, help="scene.safetensors")
    verb.add_argument("--ply", metavar="PLY", type=Path, help="splats exported from SCENE (default: baked now)")
    verb.add_argument("--host", default="127.0.0.1", help="address to listen on (default: this machine only)")
    verb.add_argument("--port", type=int, default=8080, help="port to listen on (default: 8080)")
    _add_bake(verb)


def _add_bake(verb: argparse.ArgumentParser) -> None:
    text = "fitting steps, 0 for each anchor's own colour (default: 120)"
    verb.add_argument("--steps", metavar="N", type=int, help=text)
    text = "views to fit and to play: a path's name or a camera file (default: the scene's own, else spiral)"
    verb.add_argument("--trajectory", metavar="PATH", help=text)


def _add_path(verb: argparse.ArgumentParser, default: str | None) -> None:
    text = "vistadream, spiral, orbit, swing, dolly, forward, back, or a camera file (.json)"
    text += f" (default: {default})" if default else ""
    verb.add_argument("--trajectory", metavar="PATH", default=default, required=default is None, help=text)
    verb.add_argument("--frames", metavar="N", type=int, help="this many frames, evenly spaced (default: the path's)")
    verb.add_argument("--fps", type=float, default=20.0, help="frames a second of the video (default: 20)")
    verb.add_argument("--device", default="cpu", help="cpu or cuda (default: cpu)")


def _run(arguments: argparse.Namespace) -> tuple[dict[str, object], str]:
    """Run the verb; returns a JSON-ready document and the same for people."""
    from orca import commands, splat_commands

    verbs: dict[str, Callable[[argparse.Namespace], tuple[dict[str, object], str]]] = {
        "reconstruct": commands.reconstruct,
        "render": commands.render,
        "export": splat_commands.export,
        "view": lambda given: splat_commands.view(given, lambda text: print(text, file=sys.stderr, flush=True)),
        "info": commands.info,
    }
    return verbs[arguments.verb](arguments)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code: 0, or 2 for an expected error (three lines on stderr)."""
    arguments = build_parser().parse_args(argv)
    logging.basicConfig(level=logging.WARNING, format="orca: %(levelname)s: %(message)s", stream=sys.stderr)
    try:
        document, text = _run(arguments)
    except OrcaError as error:
        if arguments.debug:
            raise
        print(f"orca: {error}", file=sys.stderr)
        return 2
    print(json.dumps(document, indent=1) if arguments.json else text)
    return 0
