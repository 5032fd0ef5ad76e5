"""Crops of hands for training, drawn directly: no video is written and no full picture rendered.

Everything at an instant, both hands and any box, is seen in one scene with one mesh. A crop shows what cutting it out
of the camera's rectified picture would show: the same content at the crop's resolution, black beyond the raw picture.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from jaxtyping import Bool, Float64, UInt8

from assemblyhands_core.data.assemblyhands import RECTIFIED_FOCAL_SCALE
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.crops import crop_camera, rectified, source_pixels, valid_mask
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS, Hand
from assemblyhands_core.synthetic.bodies import Scene
from assemblyhands_core.synthetic.crop_boxes import TIGHT_BOX, CropBox, Windows
from assemblyhands_core.synthetic.figure import JOINT_OWNERS
from assemblyhands_core.synthetic.render import BackgroundCache, Sensor, render_crops, visibility
from assemblyhands_core.synthetic.rig import Rig
from assemblyhands_core.synthetic.scene import Studio
from assemblyhands_core.synthetic.take import State, Take

_BOX_STREAM: Final = 0xC409
_OUTLINE_POINTS: Final = 17
_TICKS_PER_S: Final = 1000
"""Instants closer than a tick share their noise."""


@dataclass(frozen=True, eq=False)
class HandViews:
    """One hand at one instant, as the crops of some cameras.

    Attributes:
        hand: Which.
        t_s: The instant.
        images: RGB; grey three times from mono cameras, black where a view is not valid.
        object_id: What the centre of each pixel shows; 0 where a view is not valid or beyond the raw picture.
        cameras: The exact pinhole of each crop; of a view that is not valid without meaning.
        is_valid: Views in whose picture at least one joint lies and whose window shows some of the picture.
        joints_world_mm: The truth.
        joints_px: In the crops; NaN behind a camera.
        is_in_crop: Joints within a crop of a valid view, hidden or not.
        is_visible: Joints within the camera's picture that nothing hides, whether the crop shows them or not.
        verb: What is being done; empty between actions.
        noun: With what.
        occlusion_rate: Share of hidden joints among those in the pictures; NaN when none is.
    """

    hand: Hand
    t_s: float
    images: UInt8[np.ndarray, "view size size 3"]
    object_id: UInt8[np.ndarray, "view size size"]
    cameras: tuple[Camera, ...]
    is_valid: Bool[np.ndarray, " view"]
    joints_world_mm: Float64[np.ndarray, "joint=21 3"]
    joints_px: Float64[np.ndarray, "view joint=21 2"]
    is_in_crop: Bool[np.ndarray, "view joint=21"]
    is_visible: Bool[np.ndarray, "view joint=21"]
    verb: str
    noun: str
    occlusion_rate: float


@dataclass(frozen=True, eq=False)
class CropInstant:
    """An instant of a take, ready to be cropped any number of times.

    Attributes:
        state: What happens.
        scene: What is visible.
        sources: The cameras with their lenses, at their poses.
        sensors: Of the cameras.
        cache: Of the take.
    """

    state: State
    scene: Scene
    sources: tuple[Camera, ...]
    sensors: tuple[Sensor, ...]
    cache: BackgroundCache

    def hand_views(self, hand: Hand, size_px: int, box: CropBox, seed: int = 0) -> HandViews:
        """Crop one hand out of every view.

        Args:
            hand: Which.
            size_px: Side of the crops.
            box: Where to cut.
            seed: Of the noise of the box; the noise of the pictures depends on take, instant and hand only.
        """
        joints = self._both_mm[HANDS.index(hand)]
        tick = round(self.state.t_s * _TICKS_PER_S) % 2**32
        rng = np.random.default_rng([self.scene.seed, tick, HANDS.index(hand), seed, _BOX_STREAM])
        windows = box.windows(self.rectified, joints, rng)
        is_inside = self._is_in_picture[:, HANDS.index(hand)]
        has_window = is_inside.any(axis=-1) & np.isfinite(windows.sides_px)
        cameras = tuple(self._crop(view, windows, size_px, bool(has)) for view, has in enumerate(has_window))
        is_filled = np.stack([_filled(source, crop) for source, crop in zip(self.sources, cameras, strict=True)])
        is_filled &= has_window[:, None, None]
        is_valid = np.asarray(is_filled.any(axis=(1, 2)))
        images, object_id = self._draw(cameras, is_filled, len(HANDS) * tick + HANDS.index(hand))
        joints_px = np.stack([camera.project(joints) for camera in cameras])
        is_in_crop = np.stack([c.contains(px) for c, px in zip(cameras, joints_px, strict=True)])
        is_visible = self.is_visible[:, HANDS.index(hand)]
        verb, noun = self.state.action
        return HandViews(
            hand=hand,
            t_s=self.state.t_s,
            images=images,
            object_id=object_id,
            cameras=cameras,
            is_valid=is_valid,
            joints_world_mm=joints,
            joints_px=joints_px,
            is_in_crop=is_in_crop & is_valid[:, None],
            is_visible=is_visible,
            verb=verb,
            noun=noun,
            occlusion_rate=1.0 - float(is_visible.sum() / is_inside.sum()) if is_inside.any() else float("nan"),
        )

    @cached_property
    def rectified(self) -> tuple[Camera, ...]:
        """The pinhole cameras in whose pixels windows are given: those of the headset as the release rectifies them."""
        return tuple(
            rectified(camera, RECTIFIED_FOCAL_SCALE if sensor.is_mono else 1.0)
            for camera, sensor in zip(self.sources, self.sensors, strict=True)
        )

    @cached_property
    def is_visible(self) -> Bool[np.ndarray, "view hand=2 joint=21"]:
        """Which joints in the pictures nothing hides; found once for both hands and all boxes."""
        joints = self.state.joints_world_mm
        seen = visibility(self.scene, self.sources, joints, JOINT_OWNERS, background_cache=self.cache)
        return seen.reshape(len(self.sources), len(HANDS), NUM_JOINTS)

    @property
    def _both_mm(self) -> Float64[np.ndarray, "hand=2 joint=21 3"]:
        return self.state.joints_world_mm.reshape(len(HANDS), NUM_JOINTS, 3)

    @cached_property
    def _is_in_picture(self) -> Bool[np.ndarray, "view hand=2 joint=21"]:
        return np.stack([camera.contains(camera.project(self._both_mm)) for camera in self.sources])

    def _crop(self, view: int, windows: Windows, size_px: int, is_valid: bool) -> Camera:
        camera = self.rectified[view]
        if is_valid:
            return crop_camera(camera, windows.centers_px[view], float(windows.sides_px[view]), size_px)
        return crop_camera(camera, (camera.cx_px, camera.cy_px), float(camera.height_px), size_px)

    def _draw(
        self, cameras: Sequence[Camera], is_filled: Bool[np.ndarray, "view size size"], frame_seed: int
    ) -> tuple[UInt8[np.ndarray, "view size size 3"], UInt8[np.ndarray, "view size size"]]:
        """Draw the views of which there is anything, black where the raw picture has nothing."""
        images = np.zeros((*is_filled.shape, 3), dtype=np.uint8)
        object_id = np.zeros(is_filled.shape, dtype=np.uint8)
        views = np.flatnonzero(is_filled.any(axis=(1, 2))).tolist()
        drawn = render_crops(
            self.scene,
            [cameras[view] for view in views],
            sensors=[self.sensors[view] for view in views],
            frame_seed=frame_seed,
            background_cache=self.cache,
        )
        for view, picture in zip(views, drawn, strict=True):
            colors = picture.image if picture.image.ndim == 3 else picture.image[..., None]
            images[view] = colors * is_filled[view, ..., None]
            object_id[view] = picture.object_id * is_filled[view]
        return images, object_id


class CropStudio:
    """A take in front of a rig, of which crops can be drawn; holds no full picture (well below 1 GB)."""

    def __init__(self, studio: Studio, rig: Rig, sensors: Mapping[str, Sensor]) -> None:
        """Take what `of` has made.

        Args:
            studio: The take.
            rig: Its cameras.
            sensors: Of the cameras to look through, in the order of views.
        """
        self.take = studio.take
        self.rig = rig
        self.camera_ids = tuple(sensors)
        self._studio = studio
        self._sensors = tuple(sensors.values())
        self._cache = BackgroundCache()
        self._last: CropInstant | None = None

    @classmethod
    def of(cls, take: Take, rig: Rig, sensor_seed: int, camera_ids: Sequence[str] | None = None) -> "CropStudio":
        """Furnish the studio of a take.

        Args:
            take: What happens.
            rig: The cameras.
            sensor_seed: Decides on gain, colours and noise of the cameras; recordings use the rig's day.
            camera_ids: Those to look through, by default all that stand still.

        Raises:
            ValueError: The rig lacks a camera.
        """
        chosen = tuple(rig.exo) if camera_ids is None else tuple(camera_ids)
        if missing := set(chosen) - set(rig.exo) - set(rig.ego):
            raise ValueError(f"The {rig.kind} rig has no camera {', '.join(sorted(missing))}; choose among its own.")
        sensors = {name: Sensor.from_seed(sensor_seed, name, is_mono=name in rig.ego) for name in chosen}
        return cls(Studio.of(take), rig, sensors)

    def at(self, t_s: float) -> CropInstant:
        """Return an instant; the last one asked for is kept, with its meshes."""
        if self._last is None or self._last.state.t_s != t_s:
            state = self.take.state_at(t_s)
            cameras = self.rig.cameras_at(state.T_headset_from_world)
            sources = tuple(cameras[name] for name in self.camera_ids)
            self._last = CropInstant(state, self._studio.scene(state), sources, self._sensors, self._cache)
        return self._last

    def hand_views(
        self, t_s: float, hand: Hand, size_px: int = 128, box: CropBox = TIGHT_BOX, seed: int = 0
    ) -> HandViews:
        """Crop a hand at an instant out of every view, see `CropInstant.hand_views`."""
        return self.at(t_s).hand_views(hand, size_px, box, seed)


def _filled(source: Camera, crop: Camera) -> Bool[np.ndarray, "size size"]:
    """Tell which pixels of a crop the raw picture has; if it has the outline, it has all."""
    edge = np.linspace(0.0, crop.width_px - 1.0, _OUTLINE_POINTS)
    first, last = np.zeros_like(edge), np.full_like(edge, edge[-1])
    sides = ((edge, first), (edge, last), (first, edge), (last, edge))
    outline = np.concatenate([np.stack(side, axis=-1) for side in sides])
    if source.contains(source_pixels(source, crop, outline)).all():
        return np.ones((crop.height_px, crop.width_px), dtype=bool)
    return valid_mask(source, crop)
