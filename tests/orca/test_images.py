"""Image files: every kind of pixel arrives as uint8 RGB, every bad file as a typed error."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from orca.errors import BadInput
from orca.images import load_image, save_image


def picture(height: int = 24, width: int = 32, channels: int = 3) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (height, width, channels), dtype=np.uint8)


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".tiff", ".webp"])
def test_lossless_round_trip(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"deep/er/x{suffix}"
    if suffix == ".webp":
        path.parent.mkdir(parents=True)
        Image.fromarray(picture()).save(path, lossless=True)
    else:
        save_image(path, picture())
    np.testing.assert_array_equal(load_image(path), picture())


def test_alpha_is_dropped_not_blended(tmp_path: Path) -> None:
    rgba = picture(channels=4)
    Image.fromarray(rgba).save(tmp_path / "a.png")
    np.testing.assert_array_equal(load_image(tmp_path / "a.png"), rgba[..., :3])


def test_grey_palette_and_bilevel_become_rgb(tmp_path: Path) -> None:
    grey = picture(channels=1)[..., 0]
    Image.fromarray(grey).save(tmp_path / "g.png")
    np.testing.assert_array_equal(load_image(tmp_path / "g.png"), np.repeat(grey[..., None], 3, axis=2))
    flat = np.zeros((20, 20, 3), np.uint8)
    flat[5:, :] = (200, 30, 10)
    Image.fromarray(flat).convert("P").save(tmp_path / "p.png", transparency=0)
    assert np.abs(load_image(tmp_path / "p.png").astype(int) - flat).max() <= 51  # the web palette has steps of 51
    Image.fromarray(flat).convert("1", dither=Image.Dither.NONE).save(tmp_path / "b.png")
    assert set(np.unique(load_image(tmp_path / "b.png"))) <= {0, 255}


def test_sixteen_bits_are_scaled(tmp_path: Path) -> None:
    grey = np.tile(np.linspace(0, 65535, 64).round().astype(np.uint16), (16, 1))
    cv2.imwrite(str(tmp_path / "g.png"), grey)
    np.testing.assert_array_equal(load_image(tmp_path / "g.png")[..., 0], np.round(grey / 257).astype(np.uint8))
    eight = picture()
    cv2.imwrite(str(tmp_path / "c.png"), eight[..., ::-1].astype(np.uint16) * 257)
    np.testing.assert_array_equal(load_image(tmp_path / "c.png"), eight)


def test_exif_orientation_is_applied(tmp_path: Path) -> None:
    pixels = picture()
    exif = Image.Exif()
    exif[0x0112] = 6  # the camera was turned: show it rotated 90 degrees clockwise
    Image.fromarray(pixels).save(tmp_path / "r.png", exif=exif)
    np.testing.assert_array_equal(load_image(tmp_path / "r.png"), np.rot90(pixels, -1))


def test_cmyk_jpeg(tmp_path: Path) -> None:
    red = np.zeros((32, 32, 3), np.uint8)
    red[..., 0] = 255
    Image.fromarray(red).convert("CMYK").save(tmp_path / "c.jpg", quality=95)
    assert np.abs(load_image(tmp_path / "c.jpg").astype(int) - red).max() <= 8


def bad_files(folder: Path) -> dict[str, Path]:
    save_image(folder / "good.png", picture(64, 64))
    whole = (folder / "good.png").read_bytes()
    (folder / "truncated.png").write_bytes(whole[: len(whole) // 2])
    (folder / "text.png").write_text("this is no image")
    (folder / "empty.png").write_bytes(b"")
    Image.fromarray(np.zeros((1, 1, 3), np.uint8)).save(folder / "one.png")
    Image.fromarray(np.zeros((15, 400, 3), np.uint8)).save(folder / "thin.png")
    Image.new("1", (10001, 10000)).save(folder / "huge.png")
    Image.new("1", (20000, 10000)).save(folder / "bomb.png")
    Image.fromarray(np.zeros((20, 20), np.float32)).save(folder / "float.tiff")
    names = ["truncated.png", "text.png", "empty.png", "one.png", "thin.png", "huge.png", "bomb.png", "float.tiff"]
    return {name: folder / name for name in names} | {"missing": folder / "none.png", "folder": folder}


def test_every_bad_file_is_a_typed_error(tmp_path: Path) -> None:
    for name, path in bad_files(tmp_path).items():
        with pytest.raises(BadInput) as caught:
            load_image(path)
        assert len(str(caught.value).splitlines()) == 3, name


def test_save_refuses_floats_and_unknown_suffixes(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="float64"):
        save_image(tmp_path / "x.png", np.zeros((20, 20, 3)))  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="suffix"):
        save_image(tmp_path / "x.xyz", picture())
    (tmp_path / "d.png").mkdir()
    with pytest.raises(BadInput, match="folder"):
        save_image(tmp_path / "d.png", picture())
    assert [p.name for p in tmp_path.iterdir()] == ["d.png"]


def test_a_failed_save_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save_image(tmp_path / "x.png", picture())
    before = (tmp_path / "x.png").read_bytes()

    def fail(*_: object, **__: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(Image.Image, "save", fail)
    with pytest.raises(OSError, match="disk full"):
        save_image(tmp_path / "x.png", picture(30, 30))
    assert (tmp_path / "x.png").read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["x.png"]
