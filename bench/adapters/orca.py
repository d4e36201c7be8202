"""ORCA itself as a method of the bench: reconstructed live from the case's image and reference depth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

from bench.adapters.adapter import MethodOutput, RunOptions
from bench.adapters.views import render_case
from bench.datasets.case import SceneCase
from bench.store import write_json
from orca.conventions import to_float

if TYPE_CHECKING:
    from bench.adapters.points import Overrides
    from orca.config import ReconstructConfig
    from orca.pipeline import Reconstruction
    from orca.priors.choose import Priors

__all__ = ["ORCA", "ORCA_NO_REPAIR", "ORCA_PAPER", "ORCA_PLAIN_FILL", "OrcaMethod"]

CODE_VERSION = "8"  # raised whenever the same configuration would give other frames


@dataclass(frozen=True)
class OrcaMethod:
    """ORCA with one of its two liftings (METHOD.md 3).

    Attributes:
        name: method name.
        lifting: "metric" follows the depth it is given; "relative" is the paper's formula, placed on the trajectory
            by the median ratio of its depth to the reference depth.
        repair: "preset" does what the preset says, "off" leaves disocclusions open and black, "paper" fills them by
            the paper's plain scheme.
        overrides: what a point of a sweep changes (`bench.adapters.points`).
    """

    name: str
    lifting: Literal["metric", "relative"]
    repair: Literal["preset", "off", "paper"] = "preset"
    overrides: Overrides | None = None

    def version(self, options: RunOptions) -> str:
        """Code version, preset with every resolved constant, and seed."""
        import hashlib
        import json

        config = self._config(options).to_json()
        digest = hashlib.sha256(json.dumps(config, sort_keys=True).encode()).hexdigest()[:12]
        names = self._priors(options).to_json()  # "auto" depends on which weights are here
        priors = "/".join(str(names[key]) for key in ("outpainter", "inpainter", "depth"))
        base = f"orca {CODE_VERSION}, {self._preset(options)} {digest}, {self.lifting} lifting, seed {options.seed}"
        changed = "" if self.overrides is None else f", changed {json.dumps(self.overrides.to_json())}"
        return f"{base}, priors {priors}{changed}"

    def run(self, case: SceneCase, options: RunOptions) -> MethodOutput:
        """Reconstruct the scene, then render every evaluated camera."""
        from orca.compilation import told_of_compilation
        from orca.render.surroundings import as_shown

        with told_of_compilation(options.progress):
            result = self._reconstruct(case, options)
            scene, renderer = result.scene, result.scene.renderer(options.device)
            model, seconds = self._model(result, options), result.record["seconds"]
            return render_case(
                lambda camera: as_shown(renderer.render(camera), scene.render_config),
                case,
                options,
                model,
                seconds=seconds,
            )

    def _reconstruct(self, case: SceneCase, options: RunOptions) -> Reconstruction:
        from orca.pipeline import reconstruct
        from orca.priors.depth import DepthEstimate

        config = self._config(options, case.camera.width * case.camera.height)
        novel = case.eval_trajectory.cameras()
        truth = tuple(view.camera for view in case.true_views)
        return reconstruct(
            to_float(case.image),
            case.camera,
            DepthEstimate(case.depth, case.depth_source, case.depth_is_metric, is_measured=case.depth_is_measured),
            # The last view is always watched, so a scene is repaired where it will be compared with the truth.
            (*novel, *truth),
            config,
            priors=self._priors(options),
            seed=options.seed,
            device=options.device,
            progress=options.progress,
        )

    def _priors(self, options: RunOptions) -> Priors:
        """What is not in the image comes from weights on this machine; a run downloads nothing."""
        from orca.priors.choose import Priors
        from orca.priors.hub import ModelAccess

        return Priors.of(self._config(options), ModelAccess(options.weights_dir, True, options.device), options.seed)

    def _config(self, options: RunOptions, pixels: int | None = None) -> ReconstructConfig:
        """The preset with this method's lifting, repair and overrides; ``pixels`` are those of the input image."""
        from orca.config import get_preset

        config = get_preset(self._preset(options)).with_lifting(self.lifting)
        if self.repair == "off":  # what is missing stays visible
            plain = replace(config.render, backdrop="plain")
            config = replace(config, repair=replace(config.repair, enabled=False), render=plain)
        elif self.repair == "paper":
            config = replace(config, repair=replace(config.repair, fill="paper"))
        return config if self.overrides is None else self.overrides.applied(config, pixels)

    def _preset(self, options: RunOptions) -> str:
        return (None if self.overrides is None else self.overrides.preset) or options.preset

    def _model(self, result: Reconstruction, options: RunOptions) -> dict[str, object]:
        """Size and make of the scene; the scene file is kept where the run has a place for it."""
        model: dict[str, object] = {key: value for key, value in result.record.items() if key != "seconds"}
        model |= {
            "preset": self._preset(options),
            "overrides": {} if self.overrides is None else self.overrides.to_json(),
            "lifting": self.lifting,
            "anchors": result.scene.num_anchors,
            "anchors_by_stage": result.record["anchors"],
            "repairs": len(result.ledger["repairs"]),
            "bytes": result.scene.num_bytes,
        }
        if options.work_dir is not None:
            result.scene.save(options.work_dir / "scene.safetensors")
            write_json(options.work_dir / "ledger.json", result.ledger)
        return model


ORCA = OrcaMethod("orca", "metric")
ORCA_PAPER = OrcaMethod("orca-paper", "relative")
ORCA_NO_REPAIR = OrcaMethod("orca-norepair", "metric", "off")
ORCA_PLAIN_FILL = OrcaMethod("orca-plainfill", "metric", "paper")
