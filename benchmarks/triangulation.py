"""Robust triangulation: time for 100 000 points against the number of views, and against aniposelib.

    python benchmarks/triangulation.py [--points 100000] [--anipose-points 200] [--anipose-python PYTHON]

Expect about 4 s for 8 views and 7 s for 16 on one core. aniposelib replaces opencv-python-headless by another build,
so it is best installed in an environment of its own, whose interpreter is given by --anipose-python or
ASSEMBLYHANDS_ANIPOSE_PYTHON:

    python -m venv /tmp/anipose && /tmp/anipose/bin/pip install aniposelib==0.8.0
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import numpy.typing as npt

from assemblyhands_core.geometry import transforms
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import OpenCVLens
from assemblyhands_core.geometry.triangulation import triangulate

Doubles = npt.NDArray[np.float64]

LENS = OpenCVLens(k1=-0.13, k2=0.12, k3=-0.02, p1=-6e-4, p2=7e-4)
NOISE_PX = 1.0
OUTLIER_SHARE = 0.1

ANIPOSE_PROGRAM = """
import sys, time
import numpy as np
from aniposelib.cameras import Camera, CameraGroup
data = np.load(sys.argv[1])
cameras = [
    Camera(name=str(i), size=(1920, 1080), matrix=K, dist=dist, rvec=rvec, tvec=tvec)
    for i, (K, dist, rvec, tvec) in enumerate(zip(data["K"], data["dist"], data["rvec"], data["tvec"]))
]
group, pixels = CameraGroup(cameras), data["pixels"]
group.triangulate_ransac(pixels[:, :2], undistort=True)  # compile first
begin = time.perf_counter()
points = group.triangulate_ransac(pixels, undistort=True)[0]
np.savez(sys.argv[2], points=points, seconds=time.perf_counter() - begin)
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=100_000)
    parser.add_argument("--anipose-points", type=int, default=200)
    parser.add_argument("--anipose-python", default=os.environ.get("ASSEMBLYHANDS_ANIPOSE_PYTHON", sys.executable))
    arguments = parser.parse_args()
    seconds = {num_views: time_robust(arguments.points, num_views) for num_views in (8, 16)}
    print(f"16 views take {seconds[16] / seconds[8]:.2f} times as long as 8 (2 = linear, 4 = quadratic)")
    compare_with_anipose(arguments.anipose_points, seconds[8] / arguments.points, arguments.anipose_python)


def time_robust(num_points: int, num_views: int) -> float:
    """Triangulate, print time and accuracy, return seconds."""
    cameras = make_rig(num_views)
    points, pixels, is_outlier = observe(num_points, cameras)
    triangulate(pixels[:100], cameras)
    begin = time.perf_counter()
    found = triangulate(pixels, cameras)
    seconds = time.perf_counter() - begin
    error = np.linalg.norm(found.points_world_mm - points, axis=1)
    print(
        f"{num_points} points x {num_views} views: {seconds:.2f} s, {seconds / num_points * 1e6:.1f} us per point; "
        f"ok {found.valid.mean():.4%}, median error {np.nanmedian(error):.3f} mm, max {np.nanmax(error):.2f} mm, "
        f"views rightly kept or rejected {(found.is_inlier != is_outlier).mean():.4%}"
    )
    return seconds


def compare_with_anipose(num_points: int, our_seconds_per_point: float, python: str) -> None:
    """Run aniposelib's robust mode on the first points of the same data, in its own interpreter."""
    if subprocess.run([python, "-c", "import aniposelib"], capture_output=True, check=False).returncode:
        print(f"aniposelib is absent from {python}, so it was not compared: see the head of this file.")
        return
    cameras = make_rig(8)
    points, pixels, _ = observe(num_points, cameras)
    theirs, their_seconds = run_anipose(cameras, pixels, python)
    begin = time.perf_counter()
    ours = triangulate(pixels, cameras).points_world_mm
    our_seconds = time.perf_counter() - begin
    their_error, our_error = (np.linalg.norm(found - points, axis=1) for found in (theirs, ours))
    print(
        f"{num_points} points x 8 views: aniposelib triangulate_ransac {their_seconds:.2f} s "
        f"(median error {np.nanmedian(their_error):.3f} mm, {np.mean(~(their_error < 5)):.1%} off by 5 mm or missing), "
        f"ours {our_seconds * 1e3:.1f} ms ({np.nanmedian(our_error):.3f} mm, {np.mean(~(our_error < 5)):.1%})"
    )
    print(f"same points: {their_seconds / our_seconds:.0f} times as fast")
    per_point = their_seconds / num_points / our_seconds_per_point
    print(f"per point, ours in the large run above: {per_point:.0f} times as fast (wanted: at least 20)")


def run_anipose(cameras: list[Camera], pixels: Doubles, python: str) -> tuple[Doubles, float]:
    import cv2

    with tempfile.TemporaryDirectory() as folder:
        given, answer = Path(folder) / "given.npz", Path(folder) / "answer.npz"
        np.savez(
            given,
            pixels=pixels.swapaxes(0, 1),
            K=[camera.K for camera in cameras],
            dist=np.tile([LENS.k1, LENS.k2, LENS.p1, LENS.p2, LENS.k3], (len(cameras), 1)),
            rvec=[cv2.Rodrigues(camera.T_camera_from_world[:3, :3])[0].ravel() for camera in cameras],
            tvec=[camera.T_camera_from_world[:3, 3] for camera in cameras],
        )
        subprocess.run([python, "-c", ANIPOSE_PROGRAM, str(given), str(answer)], check=True, stdout=subprocess.DEVNULL)
        with np.load(answer) as result:
            return result["points"], float(result["seconds"])


def make_rig(num_views: int) -> list[Camera]:
    """Cameras about 1 m from the origin, spread over a hemisphere, looking at it."""
    cameras = []
    for view in range(num_views):
        direction = np.array([np.cos(2.4 * view), 0.3 + 0.5 * (view % 3), np.sin(2.4 * view)])
        forward = -direction / np.linalg.norm(direction)
        right = np.cross([0.3, 1.0, 0.2], forward)
        right /= np.linalg.norm(right)
        rotation = np.stack((right, np.cross(forward, right), forward))
        pose = transforms.rigid(rotation, rotation @ forward * (900 + 40 * (view % 8)))
        cameras.append(Camera(f"c{view}", 1920, 1080, 1250.0, 1240.0, 950.0, 545.0, LENS, pose))
    return cameras


def observe(num_points: int, cameras: list[Camera]) -> tuple[Doubles, Doubles, npt.NDArray[np.bool_]]:
    """Points, their noisy pixels, and which of them were displaced by 50 to 300 px."""
    generator = np.random.default_rng(0)
    points = generator.uniform(-150, 150, (num_points, 3))
    pixels = np.stack([camera.project(points) for camera in cameras], axis=1)
    pixels += generator.normal(0, NOISE_PX, pixels.shape)
    is_outlier = generator.random(pixels.shape[:2]) < OUTLIER_SHARE
    angle = generator.uniform(0, 2 * np.pi, is_outlier.sum())
    size = generator.uniform(50, 300, is_outlier.sum())
    pixels[is_outlier] += size[:, None] * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    return points, pixels, is_outlier


if __name__ == "__main__":
    main()
