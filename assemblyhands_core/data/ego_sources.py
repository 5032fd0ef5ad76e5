"""What a recording brings of its headset: raw videos with their lenses, or the release's rectified pictures.

Either way: who the cameras are, which frames there are, where each camera is at each of them, and what is known of the
hands in them. A frame is a 30 Hz picture's number from the first one on; keys of the files count at 60 Hz.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from assemblyhands_core.data.assemblyhands import KEYS_PER_VIDEO_FRAME, EgoCalibration
from assemblyhands_core.data.assemblyhands_images import EgoImage
from assemblyhands_core.data.camera_matrices import pinhole_camera
from assemblyhands_core.data.camera_rows import camera_to_row, missing_camera_row
from assemblyhands_core.data.fine_grained import Segment, verb_at
from assemblyhands_core.data.label_rows import keys_per_frame
from assemblyhands_core.data.names import ego_video_name
from assemblyhands_core.hands.joints import HANDS

RELEASE_RATE_HZ = 30.0

Row = dict[str, Any]


@dataclass(frozen=True, eq=False)
class ReleasePictures:
    """The rectified pictures of one recording, as the release's `ego_data` lists them (formats 2.4).

    Attributes:
        images: Of this recording alone.
        folder: Where their file names begin.
        ego: Its cameras and their poses.
        first_key: Of frame 0.
        segments: What is being done when, of this recording and at 60 Hz; empty if nobody says.
    """

    images: Sequence[EgoImage]
    folder: Path
    ego: EgoCalibration
    first_key: int
    segments: Sequence[Segment] = ()

    def view_rows(self) -> Iterator[Row]:
        """Yield a row of `catalog.VIEWS`, but for the sequence, for each camera of the calibration."""
        own: dict[str, list[EgoImage]] = {name: [] for name in self.ego.camera_ids}
        for image in self.images:
            own.setdefault(ego_video_name(image.camera_id), []).append(image)
        matrices = dict(zip(self.ego.camera_ids, self.ego.K_px, strict=True))
        for name, images in own.items():
            reason, note = self._judged(name, images)
            camera = None if reason else pinhole_camera(name, matrices[name], np.eye(4), images[0].size_px)
            yield {
                "camera_id": name,
                "video_file": "",
                "video_sha256": "",
                "num_frames": max((self._frame(image) + 1 for image in images if self._is_frame(image)), default=0),
                "rate_hz": RELEASE_RATE_HZ,
                "image_fit": "" if reason else "same",
                "note": note,
                "valid": not reason,
                "reason": reason,
                **(missing_camera_row() if camera is None else camera_to_row(camera)),
            }

    def frame_rows(self) -> Iterator[Row]:
        """Yield a row of `ego_tables.EGO_FRAMES`, but for the sequence, for each picture that is at a frame."""
        unknown = np.full(16, np.nan)
        verbs = {key: verb_at(self.segments, key) for key in {image.frame_60hz for image in self.images}}
        for image in filter(self._is_frame, self.images):
            name, file = ego_video_name(image.camera_id), self.folder / image.file_name
            pose = self.ego.poses_at(image.frame_60hz).get(name)
            yield {
                "frame": self._frame(image),
                "camera_id": name,
                "T_camera_from_world": unknown if pose is None else pose.ravel(),
                "image_file": str(file),
                "image_bytes": file.stat().st_size if file.is_file() else -1,
                "verb": verbs[image.frame_60hz],
                "valid": pose is not None,
                "reason": "no_pose" if pose is None else "",
            }

    def box_rows(self) -> Iterator[Row]:
        """Yield a row of `ego_tables.EGO_BOXES`, but for the sequence, for each hand's box in each picture."""
        for image in filter(self._is_frame, self.images):
            for hand, box in image.box_px.items():
                place = {"frame": self._frame(image), "hand": hand, "camera_id": ego_video_name(image.camera_id)}
                yield {**place, "box_px": np.array(box), "is_valid": image.is_valid[HANDS.index(hand)]}

    def _judged(self, name: str, images: Sequence[EgoImage]) -> tuple[str, str]:
        if name not in self.ego.camera_ids:
            return "no_calibration", "the calibration lacks it"
        if not images:
            return "no_images", "no picture is listed"
        sizes = sorted({image.size_px for image in images})
        if len(sizes) > 1:
            listed = ", ".join(f"{width}×{height} px" for width, height in sizes)
            return "image_size_mismatch", f"its pictures are of several sizes: {listed}"
        num_odd = sum(not self._is_frame(image) for image in images)
        return (
            "",
            f"{num_odd} pictures are before key {self.first_key} or between frames, and left out" if num_odd else "",
        )

    def _frame(self, image: EgoImage) -> int:
        return (image.frame_60hz - self.first_key) // KEYS_PER_VIDEO_FRAME

    def _is_frame(self, image: EgoImage) -> bool:
        after = image.frame_60hz - self.first_key
        return after >= 0 and after % KEYS_PER_VIDEO_FRAME == 0


def pose_rows(
    view: Mapping[str, Any], ego: EgoCalibration, first_key: int, segments: Sequence[Segment] = ()
) -> Iterator[Row]:
    """Yield a row of `ego_tables.EGO_FRAMES`, but for the sequence, for each frame of a camera's video.

    Args:
        view: Row of `catalog.VIEWS`.
        ego: The recording's poses.
        first_key: 60 Hz key of frame 0.
        segments: What is being done when, at 60 Hz.
    """
    unknown, step = np.full(16, np.nan), keys_per_frame(view["rate_hz"])
    for frame in range(view["num_frames"]):
        key = first_key + step * frame
        pose = ego.poses_at(key).get(view["camera_id"])
        yield {
            "frame": frame,
            "camera_id": view["camera_id"],
            "T_camera_from_world": unknown if pose is None else pose.ravel(),
            "image_file": "",
            "image_bytes": -1,
            "verb": verb_at(segments, key),
            "valid": pose is not None,
            "reason": "" if pose is not None else "no_pose",
        }
