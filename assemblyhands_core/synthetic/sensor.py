"""From light to pixel values: what lens, sensor and camera make of a linear picture."""

import zlib
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float32, Int16, Int64, UInt8, UInt16

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.synthetic.compiled import compiled
from assemblyhands_core.synthetic.shading import WHITE

_FINE = 64  # steps of encoded pictures per grey level
_NOISE_SAMPLES = 1 << 18
_ONE, _HALF = np.float32(1), np.float32(0.5)
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
        self, linear: UInt16[np.ndarray, "height width 3"], camera: Camera
    ) -> UInt16[np.ndarray, "height width channel"]:
        """Return what the camera makes of a linear picture, before noise."""
        encoded = np.empty((*linear.shape[:2], self.num_channels), dtype=np.uint16)
        _encode(linear, self._optics(camera), _curves(self), encoded)
        return encoded

    def expose_changed(
        self,
        linear: UInt16[np.ndarray, "height width 3"],
        is_changed: UInt8[np.ndarray, "height width"],
        camera: Camera,
        noise: "Noise",
        image: UInt8[np.ndarray, "height width channel"],
    ) -> None:
        """Encode what the lens makes of changed pixels into a picture of the rest, with noise and rounded."""
        _expose_changed(linear, is_changed, self._optics(camera), _curves(self), noise.starts, noise.samples, image)

    def _optics(self, camera: Camera) -> Float32[np.ndarray, "6"]:
        numbers = 1 / camera.fx_px, 1 / camera.fy_px, camera.cx_px, camera.cy_px, self.blur, self.vignetting
        return np.array(numbers, dtype=np.float32)

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
    optics: Float32[np.ndarray, "6"],
    curves: UInt16[np.ndarray, "3 65536"],
    encoded: UInt16[np.ndarray, "height width channel"],
) -> None:
    height, width, channels = encoded.shape
    room = _rows(width)
    for row in range(height):
        _blur_row(linear, row, 0, width, optics[4], *room)
        for column in range(width):
            red, green, blue = _received(room[2], row, column, optics)
            if channels == 1:
                encoded[row, column, 0] = curves[0, _grey(red, green, blue)]
            else:
                encoded[row, column, 0] = curves[0, _index(red)]
                encoded[row, column, 1] = curves[1, _index(green)]
                encoded[row, column, 2] = curves[2, _index(blue)]


@compiled
def _rows(
    width: int,
) -> tuple[Float32[np.ndarray, " padded"], Float32[np.ndarray, " padded"], Float32[np.ndarray, " number"]]:
    """Return room for the rows above and below a row, for itself, and for what is made of them."""
    return np.empty(3 * width + 6, np.float32), np.empty(3 * width + 6, np.float32), np.empty(3 * width, np.float32)


@compiled
def _blur_row(
    linear: UInt16[np.ndarray, "height width 3"],
    row: int,
    start: int,
    end: int,
    share: np.float32,
    beside: Float32[np.ndarray, " padded"],
    here: Float32[np.ndarray, " padded"],
    blurred: Float32[np.ndarray, " number"],
) -> None:
    """Blur a row between two columns, number by number without branches, so that many are worked out at once."""
    height, width, _ = linear.shape
    up, down = linear[max(row - 1, 0)].reshape(-1), linear[min(row + 1, height - 1)].reshape(-1)
    middle = linear[row].reshape(-1)
    first, last = max(start - 1, 0), min(end + 1, width)
    for i in range(3 * first, 3 * last):
        beside[i + 3] = np.float32(np.int32(up[i]) + np.int32(down[i]))
        here[i + 3] = np.float32(middle[i])
    for k in range(3):  # beyond the first and the last column there are the same again
        beside[k], here[k] = beside[k + 3], here[k + 3]
        beside[3 * width + 3 + k], here[3 * width + 3 + k] = beside[3 * width + k], here[3 * width + k]
    rest = _ONE - share - share
    corner, side, center = share * share, share * rest, rest * rest
    for i in range(3 * start, 3 * end):
        sides = beside[i + 3] + here[i] + here[i + 6]
        blurred[i] = corner * (beside[i] + beside[i + 6]) + side * sides + center * here[i + 3]


@compiled
def _received(
    blurred: Float32[np.ndarray, " number"], row: int, column: int, optics: Float32[np.ndarray, "6"]
) -> tuple[np.float32, np.float32, np.float32]:
    """Return the light on a pixel of a blurred row: less towards the corners."""
    x = (np.float32(column) - optics[2]) * optics[0]
    y = (np.float32(row) - optics[3]) * optics[1]
    light = _ONE / (_ONE + optics[5] * (x * x + y * y))
    return blurred[3 * column] * light, blurred[3 * column + 1] * light, blurred[3 * column + 2] * light


@compiled
def _index(light: np.float32) -> int:
    return min(int(light + _HALF), 65535)


@compiled
def _grey(red: np.float32, green: np.float32, blue: np.float32) -> int:
    return _index(_LUMINANCE[0] * red + _LUMINANCE[1] * green + _LUMINANCE[2] * blue)


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
def _expose_changed(
    linear: UInt16[np.ndarray, "height width 3"],
    is_changed: UInt8[np.ndarray, "height width"],
    optics: Float32[np.ndarray, "6"],
    curves: UInt16[np.ndarray, "3 65536"],
    starts: Int64[np.ndarray, " height"],
    samples: Int16[np.ndarray, " sample"],
    image: UInt8[np.ndarray, "height width channel"],
) -> None:
    height, width, channels = image.shape
    room = _rows(width)
    for row in range(height):
        start, end = _changed_part(is_changed[row])
        if start < end:
            _blur_row(linear, row, start, end, optics[4], *room)
        for column in range(start, end):
            if is_changed[row, column]:
                place = starts[row] + column * channels
                red, green, blue = _received(room[2], row, column, optics)
                if channels == 1:
                    image[row, column, 0] = _rounded(curves[0, _grey(red, green, blue)], samples[place])
                else:
                    image[row, column, 0] = _rounded(curves[0, _index(red)], samples[place])
                    image[row, column, 1] = _rounded(curves[1, _index(green)], samples[place + 1])
                    image[row, column, 2] = _rounded(curves[2, _index(blue)], samples[place + 2])


@compiled
def _changed_part(is_changed: UInt8[np.ndarray, " width"]) -> tuple[int, int]:
    """Return the first column that is changed and the one after the last."""
    start, end = 0, len(is_changed)
    while end > 0 and not is_changed[end - 1]:
        end -= 1
    while start < end and not is_changed[start]:
        start += 1
    return start, end


@compiled
def _rounded(encoded: int, noise: int) -> int:
    return min(max(int(encoded) + int(noise) + _FINE // 2, 0) // _FINE, 255)
