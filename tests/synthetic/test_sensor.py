"""From light to pixel values, by hand."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_scenes import PLAIN, make_camera

from assemblyhands_core.synthetic.sensor import Sensor
from assemblyhands_core.synthetic.shading import WHITE

CAMERA = make_camera(size=(64, 48))


def _expose(sensor: Sensor, linear: np.ndarray, frame: int = 0) -> np.ndarray:
    return sensor.noise_of(CAMERA, 0, frame).expose(sensor.encode(linear, CAMERA))


def _even(*light: float) -> np.ndarray:
    return np.full((48, 64, 3), np.rint(np.array(light) * WHITE), dtype=np.uint16)


def test_values_by_hand() -> None:
    light = _even(0.1, 0.2, 0.4)
    assert _expose(PLAIN, light)[5, 5].tolist() == [26, 51, 102]  # 25.5 is rounded up
    assert _expose(replace(PLAIN, gamma=2.0), light)[5, 5].tolist() == [81, 114, 161]
    assert _expose(replace(PLAIN, gain=1.4), light)[5, 5].tolist() == [36, 71, 143]
    assert _expose(replace(PLAIN, white_balance=(1.2, 1.0, 0.8)), light)[5, 5].tolist() == [31, 51, 82]
    assert _expose(replace(PLAIN, is_mono=True), light)[5, 5].tolist() == [51]  # 0.3 0.1 + 0.55 0.2 + 0.15 0.4 = 0.2
    tone = 0.4 + 0.5 * (3 * 0.4**2 - 2 * 0.4**3 - 0.4)
    assert _expose(replace(PLAIN, contrast=0.5), light)[5, 5, 2] == round(255 * tone)


def test_highlights_are_rolled_off() -> None:
    values = [_expose(PLAIN, _even(light, light, light))[0, 0, 0] for light in (0.6, 0.8, 1.0, 1.6, 3.9)]
    assert values == [153, 200, 231, 254, 255]  # 0.6 + 0.4 tanh((x - 0.6) / 0.4)


def test_the_lens_blurs_by_its_share_and_keeps_the_light() -> None:
    linear = _even(0.0, 0.0, 0.0)
    linear[20, 30] = WHITE // 2
    image = _expose(replace(PLAIN, blur=0.1), linear)[..., 0].astype(float)
    expected = 127.5 * np.outer([0.1, 0.8, 0.1], [0.1, 0.8, 0.1])
    np.testing.assert_allclose(image[19:22, 29:32], expected, atol=0.51)
    assert np.count_nonzero(image) == 9


def test_corners_are_darker() -> None:
    image = _expose(replace(PLAIN, vignetting=0.3), _even(0.5, 0.5, 0.5))[..., 0]
    x, y = (0 - CAMERA.cx_px) / CAMERA.fx_px, (0 - CAMERA.cy_px) / CAMERA.fy_px
    assert image[24, 32] == 127 and image[0, 0] == round(127.5 / (1 + 0.3 * (x * x + y * y)))


@pytest.mark.parametrize("deviation", [1.0, 4.0])
def test_noise_has_its_deviation_and_no_bias(deviation: float) -> None:
    sensor, light = replace(PLAIN, noise=deviation), _even(0.4, 0.4, 0.4)
    stack = np.stack([_expose(sensor, light, frame) for frame in range(40)]).astype(float)
    assert np.mean(stack) == pytest.approx(102.0, abs=0.05)
    assert np.std(stack) == pytest.approx(np.hypot(deviation, 1 / np.sqrt(12)), rel=0.02)
    rows = stack[0, :, :, 0] - 102.0
    assert abs(np.corrcoef(rows[:-1].ravel(), rows[1:].ravel())[0, 1]) < 0.05


def test_single_pixels_get_what_they_get_in_the_whole() -> None:
    generator = np.random.default_rng(0)
    linear = generator.integers(0, WHITE, (48, 64, 3)).astype(np.uint16)
    for is_mono in (False, True):
        sensor = Sensor(is_mono=is_mono)
        whole, noise = _expose(sensor, linear), sensor.noise_of(CAMERA, 0, 0)
        image, is_changed = np.zeros_like(whole), np.zeros((48, 64), np.uint8)
        pixels = np.array([0, 63, 700, 64 * 48 - 1])
        is_changed.ravel()[pixels] = 1
        sensor.expose_changed(linear, is_changed, CAMERA, noise, image)
        np.testing.assert_array_equal(image.reshape(64 * 48, -1)[pixels], whole.reshape(64 * 48, -1)[pixels])
        assert np.count_nonzero(image.any(axis=-1)) == 4


def test_cameras_differ_and_repeat() -> None:
    sensors = [Sensor.from_seed(seed, name) for seed in (0, 1) for name in ("a", "b")]
    assert len({sensor.gain for sensor in sensors}) == 4 and Sensor.from_seed(1, "b") == sensors[3]
    assert all(0.6 < sensor.gain < 1.6 and not sensor.is_mono for sensor in sensors)
    assert Sensor.from_seed(0, "a", is_mono=True).num_channels == 1
