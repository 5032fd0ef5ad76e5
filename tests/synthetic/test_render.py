"""Pictures: where things are drawn, what they hide, what noise they have, and that short cuts change nothing."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import cv2
import numpy as np
import pytest
from drawn_scenes import PLAIN, make_camera, make_floor, make_scene, make_sphere

from assemblyhands_core.geometry.crops import crop_camera, rectified
from assemblyhands_core.geometry.distortion import OVFishEye62
from assemblyhands_core.synthetic.render import BackgroundCache, Sensor, render, render_crops

MODELS = ["Pinhole", "OpenCV", "OVFishEye62"]


@pytest.mark.parametrize("model", MODELS)
def test_small_bright_balls_appear_where_the_camera_projects_them(model: str) -> None:
    camera = make_camera(model, size=(960, 720))
    x, z = np.meshgrid(np.linspace(-480.3, 430.1, 6), np.linspace(-310.7, 350.9, 5))
    places = np.stack((x.ravel(), 40 * np.sin(x * z).ravel(), z.ravel()), axis=-1)
    balls = tuple(make_sphere(k + 1, tuple(place), 12.0, albedo=1.0) for k, place in enumerate(places))
    scene = replace(make_scene(moving=balls, lights=()), ambient=(0.3, 0.3, 0.3))
    taken = render(scene, camera, sensor=replace(PLAIN, is_mono=True), frame_seed=0)
    rows, columns = np.indices(taken.image.shape)
    ids = taken.object_id.ravel()
    counts = np.bincount(ids)[1:]
    found = np.stack([np.bincount(ids, (taken.image > 0).ravel() * axis.ravel())[1:] for axis in (columns, rows)], 1)
    offsets = found / counts[:, None] - camera.project(places)
    assert np.abs(offsets).max() < 0.25  # the outline is made of whole pixels
    np.testing.assert_allclose(offsets.mean(axis=0), 0.0, rtol=0, atol=0.05)


def test_a_ball_covers_its_outline() -> None:
    camera = make_camera(size=(960, 720))
    scene = make_scene(static=(make_floor(),), moving=(make_sphere(7, (0.0, 300.0, 0.0), 120.0, subdivisions=5),))
    covered = int((render(scene, camera, sensor=PLAIN, frame_seed=0).object_id == 7).sum())
    tangent = 120.0 / np.sqrt(700.0**2 - 120.0**2)  # of the cone of rays that touch the ball, on the axis
    assert covered == pytest.approx(np.pi * (tangent * camera.fx_px) ** 2, rel=0.01)


def test_what_is_nearer_hides_what_is_behind() -> None:
    camera = make_camera()
    low, high = make_sphere(1, (0.0, 100.0, 0.0), 80.0), make_sphere(2, (60.0, 400.0, 0.0), 40.0)
    for static, moving in [((), (low, high)), ((low,), (high,)), ((high,), (low,)), ((low, high), ())]:
        ids = render(make_scene(static, moving), camera, sensor=PLAIN, frame_seed=0).object_id
        x, y = np.rint(camera.project(np.array([[-50.0, 100.0, 0.0], [60.0, 400.0, 0.0]]))).astype(int).T
        assert ids[y[0], x[0]] == 1 and ids[y[1], x[1]] == 2 and ids[0, 0] == 0


def test_the_same_seed_gives_the_same_picture_in_any_order() -> None:
    cameras = [make_camera(model) for model in MODELS]
    floor, ball = make_floor(), make_sphere(1, (0.0, 200.0, 0.0), 90.0)
    scenes = [make_scene((floor,), (replace(ball, vertices_mm=ball.vertices_mm + np.float32(x)),)) for x in (0, 20)]
    jobs = [(scene, camera) for scene in scenes for camera in cameras]

    def take(jobs: list) -> dict:
        cache, sensor = BackgroundCache(), Sensor(noise=3.0)
        with ThreadPoolExecutor(3) as pool:
            images = pool.map(lambda job: render(*job, sensor=sensor, frame_seed=4, background_cache=cache).image, jobs)
            return dict(zip([(id(scene), camera.camera_id) for scene, camera in jobs], images, strict=True))

    once, again = take(jobs), take(jobs[::-1])
    assert all(np.array_equal(once[key], again[key]) for key in once) and len(once) == 6


def test_noise_depends_on_the_seed_the_camera_and_the_frame() -> None:
    scene, camera = make_scene((make_floor(),)), make_camera()

    def image(seed: int, camera_id: str, frame: int) -> np.ndarray:
        named = replace(camera, camera_id=camera_id)
        return render(replace(scene, seed=seed), named, sensor=Sensor(noise=3.0), frame_seed=frame).image.astype(float)

    first = image(0, "a", 0)
    np.testing.assert_array_equal(first, image(0, "a", 0))
    for other in (image(1, "a", 0), image(0, "b", 0), image(0, "a", 1)):
        assert np.std(first - other) == pytest.approx(3.0 * np.sqrt(2), rel=0.03)


def test_the_kept_background_changes_nothing() -> None:
    camera, cache = make_camera("OpenCV", size=(640, 480)), BackgroundCache()
    static = make_floor(), make_sphere(9, (-250.0, 100.0, 0.0), 60.0)
    for x in (0.0, 120.0):
        scene = make_scene(static, (make_sphere(1, (x, 250.0, 30.0), 70.0),))
        whole = render(scene, camera, sensor=Sensor(), frame_seed=2)
        kept = render(scene, camera, sensor=Sensor(), frame_seed=2, background_cache=cache)
        np.testing.assert_array_equal(kept.object_id, whole.object_id)
        difference = np.abs(kept.image.astype(int) - whole.image)
        assert (difference > 0).mean() < 0.002 and (difference > 2).mean() < 3e-4  # where two shadows overlap
    empty = make_scene(static)
    np.testing.assert_array_equal(
        render(empty, camera, sensor=Sensor(), frame_seed=3, background_cache=cache).image,
        render(empty, camera, sensor=Sensor(), frame_seed=3).image,
    )


def test_other_static_bodies_than_those_kept_are_refused() -> None:
    cache, camera = BackgroundCache(), make_camera()
    render(make_scene((make_floor(),)), camera, sensor=PLAIN, frame_seed=0, background_cache=cache)
    with pytest.raises(ValueError, match="make a new BackgroundCache for each recording"):
        render(make_scene((make_floor(),)), camera, sensor=PLAIN, frame_seed=0, background_cache=cache)


@pytest.mark.parametrize(
    ("center_px", "side_px", "mean", "fraction"), [(331.5, 150.0, 0.02, 1e-3), (330.2, 300.0, 1.0, 0.03)]
)
def test_a_crop_is_the_same_part_of_the_whole_picture(
    center_px: float, side_px: float, mean: float, fraction: float
) -> None:
    camera = rectified(make_camera("OpenCV", size=(640, 480)))
    scene = make_scene((make_floor(),), (make_sphere(1, (40.0, 250.0, 30.0), 110.0),))
    crop = crop_camera(camera, (center_px, center_px - 80), side_px, 150)
    (part,) = render_crops(scene, [crop], sensors=[PLAIN], frame_seed=0)
    whole = render(scene, camera, sensor=PLAIN, frame_seed=0, background_cache=BackgroundCache())
    scale = side_px / 150
    start = (np.array([center_px, center_px - 80]) - side_px / 2) + scale * 0.5
    shift = np.array([[scale, 0.0, start[0]], [0.0, scale, start[1]]])
    cut = cv2.warpAffine(whole.image, shift, (150, 150), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    difference = np.abs(cut.astype(int) - part.image)
    assert np.mean(difference) < mean and (difference > 8).mean() < fraction
    assert len(np.unique(part.object_id)) == 2


def test_pixels_outside_the_field_of_the_lens_are_black() -> None:
    camera = make_camera("OVFishEye62", size=(636, 480))
    camera = replace(camera, lens=OVFishEye62(k1=-0.2))  # whose image ends at 0.86 focal lengths
    scene = replace(make_scene((make_floor(),)), backdrop=(0.4, 0.4, 0.4))
    image = render(scene, camera, sensor=replace(PLAIN, is_mono=True), frame_seed=0).image
    rows, columns = np.indices(image.shape)
    outside = np.isnan(camera.unproject(np.stack((columns, rows), axis=-1).astype(float))).any(axis=-1)
    assert image.shape == (480, 636) and 0.05 < outside.mean() < 0.9
    assert (image[outside] == 0).all() and (image[~outside] == 0).mean() < 0.01


def test_a_moving_camera_keeps_nothing() -> None:
    cache, scene = BackgroundCache(), make_scene((make_floor(),), (make_sphere(1, (0.0, 200.0, 0.0), 90.0),))
    for height in (900.0, 1100.0):
        camera = make_camera("OVFishEye62", height)
        moved = render(scene, camera, sensor=PLAIN, frame_seed=0, background_cache=cache, is_fixed=False)
        np.testing.assert_array_equal(moved.image, render(scene, camera, sensor=PLAIN, frame_seed=0).image)
    assert not cache.num_views
