"""Known mappings between calibrated image and video, recovered from sizes and pictures; then the real demo."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from assemblyhands_core.data.image_fit import fit_image
from assemblyhands_core.data.rigs import read_calibration
from assemblyhands_core.data.video import VideoReader
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import OpenCVLens

REPOSITORY = Path(__file__).resolve().parents[2]


def camera(width_px: int = 1088, height_px: int = 1920) -> Camera:
    lens = OpenCVLens(k1=-0.05, k2=0.1, p1=0.001)
    return Camera("cam01", width_px, height_px, 1680.0, 1690.0, 533.0, 950.0, lens, np.eye(4))


def picture(width_px: int, height_px: int, left: int = 0, right: int = 0, top: int = 0, bottom: int = 0) -> np.ndarray:
    """A bright noisy scene with noisy black bars, as a decoder leaves them."""
    rng = np.random.default_rng(0)
    image = rng.integers(60, 255, (height_px, width_px, 3), dtype=np.uint8)
    bars = np.ones((height_px, width_px), dtype=bool)
    bars[top : height_px - bottom, left : width_px - right] = False
    image[bars] = rng.integers(0, 12, (int(bars.sum()), 3))
    return image


def assert_maps(
    fitted: Camera | None, calibrated: Camera, scale: tuple[float, float], shift: tuple[float, float]
) -> None:
    """The fitted camera sees every point at (u + 0.5) s - 0.5 + shift."""
    assert fitted is not None
    points = np.random.default_rng(1).uniform([-500, -900, 2000], [500, 900, 4000], (100, 3))
    expected = (calibrated.project(points) + 0.5) * scale - 0.5 + shift
    np.testing.assert_allclose(fitted.project(points), expected, rtol=0, atol=1e-9)


def test_equal_sizes_are_the_same() -> None:
    fit = fit_image(camera(), picture(1088, 1920))
    assert (fit.kind, fit.reason, fit.is_suspect) == ("same", None, False)
    assert_maps(fit.camera, camera(), (1, 1), (0, 0))
    assert fit.sentence == "cam01: the video is 1088x1920 px, the calibration 1088x1920: the same."


def test_equal_sizes_with_black_edges_are_suspect() -> None:
    fit = fit_image(camera(), picture(1088, 1920, top=7, bottom=8, left=1))
    assert (fit.kind, fit.is_suspect) == ("same", True)
    assert "black edges (7 px top, 8 px bottom)" in fit.sentence


@pytest.mark.parametrize(
    "size", [(544, 960), (1080, 1906), (2176, 3840), (272, 480), (1087, 1918), (100, 176), (101, 178)]
)
def test_equal_aspect_is_scaled(size: tuple[int, int]) -> None:
    fit = fit_image(camera(), picture(*size))
    assert (fit.kind, fit.reason) == ("scaled", None)
    assert_maps(fit.camera, camera(), (size[0] / 1088, size[1] / 1920), (0, 0))
    assert (fit.camera.width_px, fit.camera.height_px) == size


def test_bars_at_top_and_bottom_are_letterboxing() -> None:
    """1920 · 1080/1088 = 1905.9, so 1906 rows between two bars of 7."""
    fit = fit_image(camera(), picture(1080, 1920, top=7, bottom=7))
    assert (fit.kind, fit.reason) == ("letterboxed", None)
    assert_maps(fit.camera, camera(), (1080 / 1088, 1906 / 1920), (0, 7))
    assert (fit.camera.width_px, fit.camera.height_px) == (1080, 1920)
    assert fit.sentence.endswith("letterboxed, scaled by 0.9927 between black bars of 7 and 7 px top and bottom.")


def test_bars_at_left_and_right_are_letterboxing() -> None:
    """640×480 in 960×540: scale 1.125, 720 columns between two bars of 120."""
    calibrated = camera(640, 480)
    fit = fit_image(calibrated, picture(960, 540, left=120, right=120))
    assert fit.kind == "letterboxed"
    assert_maps(fit.camera, calibrated, (1.125, 1.125), (120, 0))


@pytest.mark.parametrize(("top", "bottom"), [(60, 61), (61, 60)])
def test_an_odd_rest_is_split_as_the_picture_shows(top: int, bottom: int) -> None:
    """1920×1080 in 640×481: scale 1/3, 360 rows, 121 left over."""
    calibrated = camera(1920, 1080)
    fit = fit_image(calibrated, picture(640, 481, top=top, bottom=bottom))
    assert fit.kind == "letterboxed"
    assert_maps(fit.camera, calibrated, (1 / 3, 1 / 3), (0, top))


@pytest.mark.parametrize("bars", [(6, 6), (7, 6), (8, 8), (6, 8)])
def test_bars_may_be_a_row_off(bars: tuple[int, int]) -> None:
    fit = fit_image(camera(), picture(1080, 1920, top=bars[0], bottom=bars[1]))
    assert fit.kind == "letterboxed"
    assert_maps(fit.camera, camera(), (1080 / 1088, 1906 / 1920), (0, 7))


@pytest.mark.parametrize("bars", [(0, 0), (7, 0), (0, 7), (14, 0), (0, 14), (5, 7), (7, 9), (200, 200), (960, 960)])
def test_other_bars_prove_nothing(bars: tuple[int, int]) -> None:
    fit = fit_image(camera(), picture(1080, 1920, top=bars[0], bottom=bars[1]))
    assert (fit.kind, fit.camera, fit.reason) == ("unknown", None, "image_size_mismatch")
    assert "bars of 7.1 px top and bottom" in fit.sentence and "say ingest.image_fit=" in fit.sentence


def test_bars_on_the_wrong_sides_prove_nothing() -> None:
    assert fit_image(camera(), picture(1080, 1920, left=7, right=7)).kind == "unknown"


def test_a_video_on_its_side_is_told() -> None:
    fit = fit_image(camera(), picture(1920, 1088))
    assert fit.kind == "unknown" and "it lies on its side; turn the video" in fit.sentence


@pytest.mark.parametrize(
    ("choice", "scale", "shift"),
    [
        ("scaled", (1080 / 1088, 1), (0, 0)),
        ("letterboxed", (1080 / 1088, 1906 / 1920), (0, 7)),
        ("cropped", (1, 1), (-4, 0)),
    ],
)
def test_the_user_may_know_better(choice: str, scale: tuple[float, float], shift: tuple[float, float]) -> None:
    fit = fit_image(camera(), picture(1080, 1920), choice)  # no bars to prove anything
    assert fit.kind == choice and "as you said" in fit.sentence
    assert_maps(fit.camera, camera(), scale, shift)
    assert (fit.camera.width_px, fit.camera.height_px) == (1080, 1920)


@pytest.mark.usefixtures("unchecked_types")
def test_impossible_choices_are_refused() -> None:
    with pytest.raises(ValueError, match=r"cam01: the video is 1080x1920.*cannot be 'same'"):
        fit_image(camera(), picture(1080, 1920), "same")
    with pytest.raises(ValueError, match="a part cannot be larger than the whole"):
        fit_image(camera(), picture(1090, 1920), "cropped")
    with pytest.raises(ValueError, match="image fit 'squeezed' is unknown; use one of auto, same"):
        fit_image(camera(), picture(64, 64), "squeezed")


@pytest.fixture(scope="module")
def demo() -> Path:
    """Pose2Sim's single-person demo, from its unpacked wheel."""
    default = REPOSITORY / "work" / "downloads" / "pose2sim"
    root = Path(os.environ.get("ASSEMBLYHANDS_POSE2SIM", default))
    folder = root / "Pose2Sim" / "Demo_SinglePerson"
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent: set ASSEMBLYHANDS_POSE2SIM to an unpacked pose2sim wheel to run this test")
    return folder


@pytest.mark.parametrize(
    ("name", "kind"), [("01", "letterboxed"), ("02", "letterboxed"), ("03", "same"), ("04", "same")]
)
@pytest.mark.parametrize("frame", [0, 15])
def test_the_demo_has_two_letterboxed_cameras(demo: Path, name: str, kind: str, frame: int) -> None:
    calibrated = read_calibration(demo / "calibration" / "Calib.qca.txt")[f"cam{name}"]
    (_, image), *_ = VideoReader(demo / "videos" / f"cam{name}.mp4").frames(frame, 1)
    fit = fit_image(calibrated, image)
    assert (fit.kind, fit.is_suspect) == (kind, False)
    if kind == "letterboxed":
        assert_maps(fit.camera, calibrated, (1080 / 1088, 1906 / 1920), (0, 7))


@pytest.mark.parametrize("name", ["01", "02"])
def test_the_demo_shows_its_background_where_the_fitted_camera_says(demo: Path, name: str) -> None:
    """Patches of the video are found in the still picture of the calibration at the mapped place, to about a pixel."""
    calibrated = read_calibration(demo / "calibration" / "Calib.qca.txt")[f"cam{name}"]
    path = demo / "calibration" / "extrinsics" / f"cam{name}_ext.png"
    if not path.is_file():
        pytest.skip(f"{path} is absent: unpack the whole wheel to run this test")
    still = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    (_, image), *_ = VideoReader(demo / "videos" / f"cam{name}.mp4").frames(10, 1)
    fitted = fit_image(calibrated, image).camera
    assert still is not None and still.shape == (1920, 1088) and fitted is not None
    by_choice = {"fitted": fitted, "stretched": calibrated.scaled(1080, 1920)}
    residuals = {key: _background_residuals(by, calibrated, image, still) for key, by in by_choice.items()}
    assert len(residuals["fitted"]) >= 6
    assert np.median(residuals["fitted"]) < 1.0 and np.median(residuals["stretched"]) > 2.0


def _background_residuals(fitted: Camera, calibrated: Camera, image: np.ndarray, still: np.ndarray) -> list[float]:
    """Distance in px between where a patch is found in the still and where the two cameras say it must be."""
    K_still_from_video = calibrated.K @ np.linalg.inv(fitted.K)
    mapped = cv2.warpPerspective(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), K_still_from_video, still.shape[::-1])
    edges_mapped, edges_still = (
        grey.astype(np.float32) - cv2.GaussianBlur(grey.astype(np.float32), (0, 0), 3) for grey in (mapped, still)
    )
    residuals = []
    for top in (60, 150, 300, 1500, 1620):
        for left in (60, 400, 800):
            patch = edges_mapped[top : top + 250, left : left + 200]
            area = edges_still[top - 20 : top + 270, left - 20 : left + 220]
            _, score, _, found = cv2.minMaxLoc(cv2.matchTemplate(area, patch, cv2.TM_CCOEFF_NORMED))
            if score > 0.6:
                residuals.append(float(np.hypot(found[0] - 20, found[1] - 20)))
    return residuals
