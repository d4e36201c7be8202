"""Outpainting with an inpainter: tiles cover the margin, each with something known; exemplars continue structure."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orca.errors import BadInput, Unavailable
from orca.priors.classical import TeleaInpainter
from orca.priors.exemplar import ExemplarInpainter
from orca.priors.grow import ClassicalOutpainter, InpaintingOutpainter, tiles_outwards
from orca.priors.inpaint import InpaintFailed

margin = st.integers(0, 150)


@settings(max_examples=60, deadline=None)
@given(
    st.tuples(st.integers(8, 90), st.integers(8, 90)),
    st.tuples(margin, margin, margin, margin),
    st.integers(16, 96),
    st.sampled_from([0.1, 0.25, 0.5]),
)
def test_tiles_cover_the_margin_and_each_sees_something_known(
    size: tuple[int, int], margins: tuple[int, int, int, int], tile: int, overlap: float
) -> None:
    left, top, right, bottom = margins
    known = np.zeros((size[1] + top + bottom, size[0] + left + right), bool)
    known[top : top + size[1], left : left + size[0]] = True
    for x0, y0, x1, y1 in tiles_outwards(size, margins, tile, overlap):
        assert 0 <= x0 < x1 <= known.shape[1]
        assert 0 <= y0 < y1 <= known.shape[0]
        assert max(x1 - x0, y1 - y0) <= tile
        part = known[y0:y1, x0:x1]
        assert part.any()
        part[:] = True
    assert known.all()


def test_without_a_tile_size_the_canvas_is_one_tile() -> None:
    assert list(tiles_outwards((10, 20), (1, 2, 3, 4), 0, 0.25)) == [(0, 0, 14, 26)]
    assert list(tiles_outwards((10, 20), (0, 0, 0, 0), 0, 0.25)) == []


def test_an_outpainted_canvas_keeps_the_original() -> None:
    image = np.random.default_rng(0).random((30, 40, 3), dtype=np.float32)
    for outpainter in (InpaintingOutpainter(TeleaInpainter(), "t", 24), ClassicalOutpainter()):
        canvas = outpainter.outpaint(image, 12, 0, 30, 9)
        assert canvas.shape == (39, 82, 3)
        np.testing.assert_array_equal(canvas[:30, 12:52], image)
        assert canvas[:, :12].std() > 0
        np.testing.assert_array_equal(outpainter.outpaint(image, 0, 0, 0, 0), image)
        with pytest.raises(BadInput, match="margins"):
            outpainter.outpaint(image, -1, 0, 0, 0)
        with pytest.raises(BadInput, match="shape"):
            outpainter.outpaint(image[..., 0], 1, 0, 0, 0)


def stripes(size: int = 96, period: int = 12) -> np.ndarray:
    x = np.arange(size)
    wave = ((x // (period // 2)) % 2).astype(np.float32) * 0.6 + 0.2
    return np.repeat(np.tile(wave, (size, 1))[..., None], 3, 2)


def test_an_exemplar_continues_stripes_that_diffusion_smears() -> None:
    image = stripes()
    mask = np.zeros(image.shape[:2], bool)
    mask[30:66, 30:66] = True
    errors = {}
    for inpainter in (ExemplarInpainter(), TeleaInpainter()):
        filled = inpainter.inpaint(np.where(mask[..., None], np.float32(0), image), mask)
        errors[inpainter.name] = float(np.square(filled - image)[mask].mean())
    assert errors["classical"] < 0.5 * errors["telea"]


def test_one_seed_gives_one_fill() -> None:
    image = np.random.default_rng(2).random((40, 40, 3), dtype=np.float32)
    mask = np.zeros((40, 40), bool)
    mask[10:30, 10:30] = True
    first = ExemplarInpainter(seed=3).inpaint(image, mask)
    ExemplarInpainter(seed=9).inpaint(image, mask)
    np.testing.assert_array_equal(ExemplarInpainter(seed=3).inpaint(image, mask), first)


def test_without_the_package_it_is_unavailable(monkeypatch: pytest.MonkeyPatch) -> None:
    image, mask = np.zeros((20, 20, 3), np.float32), np.eye(20, dtype=bool)
    import patchmatch

    monkeypatch.setattr(patchmatch, "patchmatch_available", False)
    with pytest.raises(Unavailable, match="native library"):
        ExemplarInpainter().inpaint(image, mask)
    monkeypatch.setitem(sys.modules, "patchmatch", None)
    with pytest.raises(Unavailable, match="PyPatchMatch"):
        ExemplarInpainter().inpaint(image, mask)


def test_a_failing_library_has_its_own_type(monkeypatch: pytest.MonkeyPatch) -> None:
    import patchmatch

    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("native")

    monkeypatch.setattr(patchmatch, "inpaint", fail)
    with pytest.raises(InpaintFailed, match="native"):
        ExemplarInpainter().inpaint(np.zeros((20, 20, 3), np.float32), np.eye(20, dtype=bool))
