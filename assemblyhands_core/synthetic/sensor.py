"""From light to pixel values: what lens, sensor and camera make of a linear picture."""

import zlib
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float32, Int16, Int32, Int64, UInt8, UInt16

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.synthetic.compiled import compiled
from assemblyhands_core.synthetic.shading import WHITE

_FINE = 64  # steps of encoded pictures per grey level
_NOISE_SAMPLES = 1 << 18
_LUMINANCE = np.array([0.30, 0.55, 0.15], dtype=np.float32)  # what a bare silicon sensor behind a lens makes of RGB


@dataclass(frozen=True)
class Sensor:
    """How a camera turns light into numbers.

    Attributes:
        is_mono: One grey channel rather than RGB.
        gain: Exposure.
        white_balance: Factors on red, green and blue.
        gamma: Of the encoding.
        contrast: How much shadows are darker and lights brighter than by gamma alone, 0..1.
        noise: Standard deviation in grey levels; after the encoding it is nearly the same in lights and shadows.
        blur: Share of each neighbour in a pixel's value, along x and y: the sharpness of the lens.
        vignetting: Loss of light where the lens looks 45° off its axis.
    """

    is_mono: bool = False
    gain: float = 1.0
    white_balance: tuple[float, float, float] = (1.0, 1.0, 1.0)
    gamma: float = 2.2
    contrast: float = 0.4
    noise: float = 2.0
    blur: float = 0.16
    vignetting: float = 0.25

    @staticmethod
    def from_seed(seed: int, camera_id: str, is_mono: bool = False) -> "Sensor":
        """Draw a camera's own gain, white balance, gamma and noise."""
        generator = np.random.default_rng([seed, zlib.crc32(camera_id.encode()), 1])
        red, blue = np.exp(generator.normal(0, 0.035, 2)).tolist()
        return Sensor(
            is_mono=is_mono,
            gain=float(np.exp(generator.normal(0, 0.10))),
            white_balance=(red, 1.0, blue),
            gamma=float(generator.uniform(2.0, 2.4)),
            contrast=float(generator.uniform(0.3, 0.6)),
            noise=float(generator.uniform(2.5, 4.0) if is_mono else generator.uniform(1.2, 2.2)),
            blur=float(generator.uniform(0.13, 0.19)),
            vignetting=float(generator.uniform(0.15, 0.35)),
        )

    @property
    def num_channels(self) -> int:
        """1 or 3."""
        return 1 if self.is_mono else 3

    def encode(
        self, linear: UInt16[np.ndarray, "height width 3"], pixels: Int32[np.ndarray, " pixel"], camera: Camera
    ) -> UInt16[np.ndarray, "pixel channel"]:
        """Return what the camera makes of some pixels (flat indices) of a linear picture, before noise."""
        optics = np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px], dtype=np.float32)
        return _encode(linear, pixels, self.blur, self.vignetting, optics, _curves(self), self.is_mono)

    def noise_of(self, camera: Camera, seed: int, frame: int) -> "Noise":
        """Return the noise of one frame."""
        generator = np.random.default_rng([seed, zlib.crc32(camera.camera_id.encode()), 2, frame])
        starts = generator.integers(0, _NOISE_SAMPLES, camera.height_px, dtype=np.int64)
        return Noise(starts, _noise_samples(self.noise, camera.width_px * self.num_channels))


@dataclass(frozen=True, eq=False)
class Noise:
    """What is added to a picture.

    Attributes:
        starts: Where each row begins in the samples.
        samples: Of all rows.
    """

    starts: Int64[np.ndarray, " height"]
    samples: Int16[np.ndarray, " sample"]

    def expose(self, encoded: UInt16[np.ndarray, "height width channel"]) -> UInt8[np.ndarray, "height width channel"]:
        """Add the noise to a picture and round."""
        return _expose(encoded, self.starts, self.samples)

    def expose_pixels(
        self,
        encoded: UInt16[np.ndarray, "pixel channel"],
        pixels: Int32[np.ndarray, " pixel"],
        image: UInt8[np.ndarray, "height width channel"],
    ) -> None:
        """Put some pixels (flat indices) into a picture, with noise and rounded."""
        _expose_pixels(encoded, pixels, self.starts, self.samples, image)


@lru_cache(64)
def _curves(sensor: Sensor) -> UInt16[np.ndarray, "3 65536"]:
    """Return the encoding of linear values: gain, balance, a soft shoulder for highlights, gamma, contrast."""
    light = np.arange(65536) / WHITE * sensor.gain
    gains = np.array((1.0, 1.0, 1.0) if sensor.is_mono else sensor.white_balance)
    exposed = light[None] * gains[:, None]
    rolled = np.where(exposed < 0.6, exposed, 0.6 + 0.4 * np.tanh((exposed - 0.6) / 0.4))
    tone = rolled ** (1 / sensor.gamma)
    tone += sensor.contrast * (tone * tone * (3 - 2 * tone) - tone)
    return np.asarray(np.rint(255 * _FINE * tone), dtype=np.uint16)


@lru_cache(64)
def _noise_samples(deviation: float, row_length: int) -> Int16[np.ndarray, " sample"]:
    """Return noise for rows that start anywhere in it; always the same, as the starts are drawn for every frame."""
    samples = np.random.default_rng(0).normal(0, deviation * _FINE, _NOISE_SAMPLES)
    repeats = 1 + -(-row_length // _NOISE_SAMPLES)
    row = np.tile(np.rint(samples).astype(np.int16), repeats + 1)
    return np.asarray(row[: _NOISE_SAMPLES + row_length])


@compiled
def _encode(
    linear: UInt16[np.ndarray, "height width 3"],
    pixels: Int32[np.ndarray, " pixel"],
    blur: float,
    vignetting: float,
    optics: Float32[np.ndarray, "4"],
    curves: UInt16[np.ndarray, "3 65536"],
    is_mono: bool,
) -> UInt16[np.ndarray, "pixel channel"]:
    height, width, _ = linear.shape
    encoded = np.empty((len(pixels), 1 if is_mono else 3), np.uint16)
    corner, side, middle = blur * blur, blur * (1 - 2 * blur), (1 - 2 * blur) ** 2
    for i in range(len(pixels)):
        row, column = pixels[i] // width, pixels[i] % width
        up, down = max(row - 1, 0), min(row + 1, height - 1)
        left, right = max(column - 1, 0), min(column + 1, width - 1)
        x, y = (column - optics[2]) / optics[0], (row - optics[3]) / optics[1]
        light = 1 / (1 + vignetting * (x * x + y * y))
        grey = 0.0
        for k in range(3):
            corners = linear[up, left, k] + linear[up, right, k] + linear[down, left, k] + linear[down, right, k]
            sides = linear[up, column, k] + linear[down, column, k] + linear[row, left, k] + linear[row, right, k]
            value = (corner * corners + side * sides + middle * linear[row, column, k]) * light
            if is_mono:
                grey += _LUMINANCE[k] * value
            else:
                encoded[i, k] = curves[k, min(int(value + 0.5), 65535)]
        if is_mono:
            encoded[i, 0] = curves[0, min(int(grey + 0.5), 65535)]
    return encoded


@compiled
def _expose(
    encoded: UInt16[np.ndarray, "height width channel"],
    starts: Int64[np.ndarray, " height"],
    samples: Int16[np.ndarray, " sample"],
) -> UInt8[np.ndarray, "height width channel"]:
    height, width, channels = encoded.shape
    image = np.empty((height, width, channels), np.uint8)
    half = np.int32(_FINE // 2)
    for row in range(height):
        values, rounded = encoded[row].reshape(-1), image[row].reshape(-1)
        noise = samples[starts[row] : starts[row] + width * channels]
        for i in range(width * channels):
            value = np.int32(values[i]) + np.int32(noise[i]) + half
            rounded[i] = min(max(value, np.int32(0)) // _FINE, np.int32(255))
    return image


@compiled
def _expose_pixels(
    encoded: UInt16[np.ndarray, "pixel channel"],
    pixels: Int32[np.ndarray, " pixel"],
    starts: Int64[np.ndarray, " height"],
    samples: Int16[np.ndarray, " sample"],
    image: UInt8[np.ndarray, "height width channel"],
) -> None:
    _, width, channels = image.shape
    for i in range(len(pixels)):
        row, column = pixels[i] // width, pixels[i] % width
        for k in range(channels):
            value = np.int32(encoded[i, k]) + samples[starts[row] + column * channels + k] + _FINE // 2
            image[row, column, k] = min(max(value, 0) // _FINE, 255)
