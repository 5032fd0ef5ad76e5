"""Solid textures."""

from typing import get_args

import numpy as np
import pytest

from assemblyhands_core.synthetic.materials import NO_TEXTURE, Pattern, Texture, paint

PATTERNS = get_args(Pattern)


def _paint(texture: Texture | None, places: np.ndarray, footprint_mm: float = 0.0) -> np.ndarray:
    albedo = np.zeros((len(places), 3), np.float32)
    row = NO_TEXTURE if texture is None else texture.row()
    footprints = np.full(len(places), footprint_mm, np.float32)
    paint(albedo, places.astype(np.float32), footprints, np.zeros(len(places), np.int32), np.array([row], np.float32))
    return albedo


def _places(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-300, 300, (20_000, 3))


@pytest.mark.parametrize("pattern", PATTERNS)
def test_patterns_mix_two_colours_and_vary(pattern: Pattern) -> None:
    albedo = _paint(Texture(pattern, (1.0, 0.5, 0.0), 10.0, contrast=0.8), _places())
    share = albedo[:, 0]
    np.testing.assert_allclose(albedo, share[:, None] * [1.0, 0.5, 0.0], atol=1e-6)
    assert share.min() >= 0.0 and share.max() <= 0.8 + 1e-6
    assert 0.1 < share.mean() < 0.7 and share.std() > 0.05


@pytest.mark.parametrize("pattern", PATTERNS)
def test_patterns_repeat_and_depend_on_the_seed(pattern: Pattern) -> None:
    kinds = [Texture(pattern, (1.0, 1.0, 1.0), 10.0, seed=seed) for seed in (1, 1, 2)]
    first, again, other = (_paint(texture, _places()) for texture in kinds)
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).mean() > 0.02


@pytest.mark.parametrize("pattern", ["wood", "cloth", "speckle", "brushed"])
def test_patterns_finer_than_a_pixel_fade(pattern: Pattern) -> None:
    texture = Texture(pattern, (1.0, 1.0, 1.0), 2.0)
    near, far = (_paint(texture, _places(), footprint)[:, 0] for footprint in (0.1, 6.0))
    assert far.std() < 0.6 * near.std() and far.mean() == pytest.approx(near.mean(), abs=0.15)


@pytest.mark.parametrize("pattern", ["wood", "brushed", "mottle", "speckle"])
def test_neighbouring_points_look_alike(pattern: Pattern) -> None:
    texture = Texture(pattern, (1.0, 1.0, 1.0), 10.0)
    change = np.abs(_paint(texture, _places()) - _paint(texture, _places() + np.array([0.01, 0.0, 0.0])))
    assert np.quantile(change, 0.999) < 0.02


def test_a_checker_by_hand() -> None:
    texture = Texture("checker", (1.0, 1.0, 1.0), 10.0)
    places = np.array([[1.0, 1.0, 1.0], [11.0, 1.0, 1.0], [11.0, 11.0, 1.0], [-1.0, 1.0, 1.0]])
    assert _paint(texture, places)[:, 0].tolist() == [0.0, 1.0, 0.0, 1.0]


def test_no_texture_leaves_the_colour() -> None:
    assert not _paint(None, _places()).any()


def test_an_unknown_pattern_is_refused() -> None:
    with pytest.raises(ValueError, match=r"no texture 'wood' with a scale of 0 mm: use one of wood, cloth"):
        Texture("wood", (1.0, 1.0, 1.0), 0)
