"""The whole pictures at an instant, of a fixed camera and of the headset, with the joints of the last round."""

from collections.abc import Iterator
from typing import Final

import cv2
import numpy as np

from assemblyhands_core.data.catalog import JOINTS
from assemblyhands_core.data.crop_images import ImageRGB
from assemblyhands_core.data.hand_crops import HandKey
from assemblyhands_core.data.rounds import joints_or_nan
from assemblyhands_core.data.video import VideoError
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.hands.joints import HANDS
from assemblyhands_core.viz.overlays import contact_sheet, draw_hand
from pipeline.finished import FinishedRun
from pipeline.html_report.page import Picture
from pipeline.html_report.pictures import from_image
from pipeline.rerun_cameras import FixedCamera, HeadsetCamera, ShownCamera, shown_cameras
from pipeline.round_crops import round_nodes
from pipeline.sequence_tables import SequenceTables, between

_SIDE_PX: Final = 640
_WIDTH_PX: Final = 470
"""Of one picture in the page; there may be two side by side."""

Hands = dict[str, np.ndarray]
"""Hand → its (joint, 3) joints in world mm, NaN where missing."""


def whole_pictures(run: FinishedRun, key: HandKey, camera_id: str) -> Picture | None:
    """Return the pictures of a fixed camera and of the headset's camera that shows most of a hand.

    Args:
        run: It has rounds.
        key: The hand and its instant; the other hand is drawn, too.
        camera_id: The fixed camera.

    Returns:
        None where neither video is where it was.
    """
    sequence_id, frame, hand = key
    tables = SequenceTables(run.folder, sequence_id)
    hands = _hands(tables, round_nodes(run.folder)[-1].name, frame)
    cameras = shown_cameras(tables, frame, frame + 1, _SIDE_PX, min_confidence=0.0)
    shown = {camera.path[-1]: camera for camera in _chosen(cameras, hands.get(hand), frame, camera_id)}
    drawn = {name: picture for name, camera in shown.items() if (picture := _drawn(camera, hands, frame)) is not None}
    if not drawn:
        return None
    captions = [f"{name}, frame {frame}" for name in drawn]
    alt = f"{' and '.join(captions)}, {sequence_id}: whole pictures without lens distortion, both hands drawn"
    sheet = contact_sheet(_equally_high(list(drawn.values())), len(drawn), captions)
    return from_image(sheet, alt, width_px=_WIDTH_PX * len(drawn))


def _equally_high(pictures: list[ImageRGB]) -> list[ImageRGB]:
    """Return the pictures as high as the lowest of them, so that none is small beside another."""
    height = min(picture.shape[0] for picture in pictures)
    sizes = [(round(picture.shape[1] * height / picture.shape[0]), height) for picture in pictures]
    return [
        np.asarray(cv2.resize(p, s, interpolation=cv2.INTER_AREA), np.uint8)
        for p, s in zip(pictures, sizes, strict=True)
    ]


def _hands(tables: SequenceTables, node: str, frame: int) -> Hands:
    joints = between(tables.read(node, "joints", JOINTS), frame, frame + 1)
    return dict(zip(joints["hand"].to_pylist(), joints_or_nan(joints), strict=True))


def _chosen(
    cameras: list[ShownCamera], joints: np.ndarray | None, frame: int, camera_id: str
) -> Iterator[FixedCamera | HeadsetCamera]:
    yield from (c for c in cameras if isinstance(c, FixedCamera) and c.raw.camera_id == camera_id)
    worn = [c for c in cameras if isinstance(c, HeadsetCamera) and frame in c.view.poses]
    if worn and joints is not None:
        best = max(worn, key=lambda c: _num_inside(_placed(c, frame), joints))
        if _num_inside(_placed(best, frame), joints):
            yield best


def _placed(camera: FixedCamera | HeadsetCamera, frame: int) -> Camera:
    """Return the camera of the pictures that are shown, where it is at a frame."""
    shown = camera.rectifier.camera
    return shown.moved(camera.view.poses[frame]) if isinstance(camera, HeadsetCamera) else shown


def _num_inside(camera: Camera, joints: np.ndarray) -> int:
    return int(camera.contains(camera.project(joints)).sum())


def _drawn(camera: FixedCamera | HeadsetCamera, hands: Hands, frame: int) -> ImageRGB | None:
    """Return the picture with the hands; None where the video is gone or lacks the frame."""
    try:
        raw = next((picture for _, picture in camera.pictures(np.array([frame], dtype=np.int64))), None)
    except VideoError:
        return None
    if raw is None:
        return None
    picture, placed = camera.rectifier(raw), _placed(camera, frame)
    for hand in HANDS:
        if hand in hands:
            pixels = placed.project(hands[hand])
            picture = draw_hand(picture, pixels, np.isfinite(pixels).all(axis=-1), hand)
    return picture
