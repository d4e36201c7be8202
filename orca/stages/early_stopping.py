"""When to stop: a smoothed PSNR, evaluated now and then, that no longer gains (paper Sec. 4.2)."""

from __future__ import annotations

from dataclasses import dataclass, field

__all__ = ["EarlyStopping"]


@dataclass
class EarlyStopping:
    """Stops after ``patience`` evaluations in a row that gain less than ``min_gain_db`` over the best.

    Attributes:
        min_gain_db: smallest gain that counts (P: 0.03 dB).
        patience: evaluations without such a gain before stopping (P: 4).
        smoothing: weight of the newest PSNR in the running mean; 1 takes the PSNR as it is.
        arm_after: no stopping before this step (P: 10,000 in stage 2).
    """

    min_gain_db: float
    patience: int
    smoothing: float
    arm_after: int = 0
    history: list[tuple[int, float, float]] = field(default_factory=list)
    _smoothed: float | None = None
    _best: float = float("-inf")
    _waited: int = 0

    def update(self, step: int, psnr_db: float) -> bool:
        """Record an evaluation; True means stop."""
        before = psnr_db if self._smoothed is None else self._smoothed
        self._smoothed = self.smoothing * psnr_db + (1 - self.smoothing) * before
        self.history.append((step, psnr_db, self._smoothed))
        if self._smoothed >= self._best + self.min_gain_db:
            self._best, self._waited = self._smoothed, 0
        elif step > self.arm_after:
            self._waited += 1
        return self._waited >= self.patience
