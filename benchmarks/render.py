"""Pictures per second of processor time, and where the time goes.

    python benchmarks/render.py [--instants 5] [--subject 3]

A person assembles a toy: hands, arms, trunk, head, tool and parts move. *Full*: 8 views of 1920 × 1080 and 4 of
636 × 480 by cameras on the head, with kept backgrounds and without. *Crops*: 8 views of 128 × 128 around each hand,
that is two hand instants, from one posture and one set of meshes. The best of the instants counts, because other work
on the machine only slows down. Time is that of the processor, in all threads; threads and memory are set as in the
workers of the pipeline.
"""

import argparse
import cProfile
import os
import pstats
import resource
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.crops import crop_camera, rectified, square_box
from assemblyhands_core.hands.joints import HANDS
from assemblyhands_core.synthetic.render import BackgroundCache, Scene, Sensor, render, render_crops
from assemblyhands_core.synthetic.rig import assembly_rig
from assemblyhands_core.synthetic.scene import Studio
from assemblyhands_core.synthetic.take import Take
from pipeline.local_cluster import KEPT_MEMORY, THREAD_VARIABLES

ENVIRONMENT = {**dict.fromkeys(THREAD_VARIABLES, "1"), **KEPT_MEMORY}  # read when a process starts
STEP_S = 0.5
PARTS = {
    "surfaces.py": "Embree: rays to lamps, primary rays of static bodies, meshes",
    "casting.py": "primary rays of moving bodies, and between rays that agree",
    "shadows.py": "shadows, without their rays",
    "coverage.py": "where shadows may fall",
    "materials.py": "textures",
    "shading.py": "reflection",
    "sensor.py": "sensor",
}


def main() -> None:
    if not ENVIRONMENT.items() <= os.environ.items():
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **ENVIRONMENT})
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--instants", type=int, default=5)
    parser.add_argument("--subject", type=int, default=3)
    options = parser.parse_args()
    bench = Bench(Studio.of(Take.from_seed(options.subject, 5, 20.0)))
    times = [4.0 + STEP_S * n for n in range(options.instants + 1)]  # the first one warms up
    ways: dict[str, tuple[Callable[[float], None], int, str]] = {
        "crops": (bench.crops, len(HANDS), "hand instants"),
        "full": (bench.full, 1, "instants"),
        "full, nothing kept": (bench.full_anew, 1, "instants"),
    }
    for name, (way, count, unit) in ways.items():
        first = _seconds(way, times[0])
        best = min(_seconds(way, t_s) for t_s in times[1:])
        print(f"{name}: {count / best:.2f} {unit} per second and core ({best * 1e3:.0f} ms for {count} {unit})")
        print(f"    first time {first:.1f} s; most memory so far {_peak_gb():.2f} GB")
        _print_parts(way, times[1])


class Bench:
    """A take in front of a rig, and what is kept of it."""

    def __init__(self, studio: Studio) -> None:
        self._studio = studio
        self._rig = assembly_rig(1)
        self._cache = BackgroundCache()

    def full(self, t_s: float) -> None:
        """Take all pictures."""
        self._take(self._scene(t_s), t_s, self._cache)

    def full_anew(self, t_s: float) -> None:
        """Take all pictures without a kept background."""
        self._take(self._scene(t_s), t_s, None)

    def crops(self, t_s: float) -> None:
        """Take pictures around both hands."""
        scene = self._scene(t_s)
        targets = [rectified(camera) for camera in self._rig.exo.values()]
        for hand in HANDS:
            (skin,) = (body.vertices_mm.astype(np.float64) for body in scene.moving if body.name == f"{hand} hand")
            boxes = [square_box(target.project(skin), 1.5) for target in targets]
            cameras = [crop_camera(target, *box, 128) for target, box in zip(targets, boxes, strict=True)]
            sensors = [_sensor(camera, False) for camera in cameras]
            render_crops(scene, cameras, sensors=sensors, frame_seed=0, background_cache=self._cache)

    def _scene(self, t_s: float) -> Scene:
        return self._studio.scene(self._studio.take.state_at(t_s))

    def _take(self, scene: Scene, t_s: float, cache: BackgroundCache | None) -> None:
        pose = self._studio.take.state_at(t_s).T_headset_from_world
        for camera_id, camera in self._rig.cameras_at(pose).items():
            is_fixed = camera_id in self._rig.exo
            sensor = _sensor(camera, not is_fixed)
            render(scene, camera, sensor=sensor, frame_seed=0, background_cache=cache, is_fixed=is_fixed)


def _sensor(camera: Camera, is_mono: bool) -> Sensor:
    return Sensor.from_seed(1, camera.camera_id, is_mono=is_mono)


def _seconds(way: Callable[[float], None], t_s: float) -> float:
    begin = time.process_time()
    way(t_s)
    return time.process_time() - begin


def _peak_gb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def _print_parts(way: Callable[[float], None], t_s: float) -> None:
    profile = cProfile.Profile(time.process_time)
    profile.runcall(way, t_s)
    seconds: Counter[str] = Counter()
    for (file, _, _), (_, _, own, _, _) in pstats.Stats(profile).stats.items():  # type: ignore[attr-defined]
        seconds[PARTS.get(Path(file).name, "the rest: copies, selections, scene")] += own
    for part, value in seconds.most_common():
        print(f"    {value / seconds.total():4.0%}  {part}")


if __name__ == "__main__":
    main()
