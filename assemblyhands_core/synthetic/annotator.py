"""A human annotator's labels, made from the truth: what the real data sets have at one instant a second.

Annotators click joints in several pictures and have them triangulated. What they cannot see in two pictures they leave
out; the fewer pictures show a joint, the less exact it is.
"""

import zlib
from collections.abc import Iterable
from typing import Final

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float64, Int64

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.assemblyhands import KEY_RATE_HZ, JointAnnotations
from assemblyhands_core.data.names import ego_serial
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS
from assemblyhands_core.synthetic.session import RATE_HZ

JOINT_NOISE_MM: Final = np.array([*[2.0, 1.5, 1.5, 1.5] * 5, 2.0])
"""Standard deviation along each axis of a joint that `ENOUGH_VIEWS` show: one to two pixels of a click, seen from 1 m
through 1250 px of focal length by several views, and the joint's centre under the skin guessed; tips and wrists have no
landmark on the skin."""

ENOUGH_VIEWS: Final = 6
"""More views make a label no better: what stays is where annotators believe the joint to be."""

MIN_VIEWS: Final = 2
"""A joint that fewer exocentric pictures show is not annotated."""

_STREAM: Final = 0xA770


def noise_mm(num_views: Int64[np.ndarray, "*hand joint=21"]) -> Float64[np.ndarray, "*hand joint=21"]:
    """Return the standard deviation of a joint's coordinates, along each axis, by how many pictures show it."""
    views = np.clip(num_views, MIN_VIEWS, ENOUGH_VIEWS)
    return np.asarray(JOINT_NOISE_MM * np.sqrt(ENOUGH_VIEWS / views))


def annotate(
    recording: str, joints: pa.Table, views: pa.Table, frames: Iterable[int], rate_hz: int = RATE_HZ
) -> JointAnnotations:
    """Return labels of some frames; the same recording and frame always get the same.

    Args:
        recording: Its name.
        joints: `ground_truth.TRUE_JOINTS` of the recording.
        views: `ground_truth.TRUE_VIEWS` of the recording. Without any exocentric one, annotators are taken to have had
            enough that are not part of it.
        frames: Of the videos, ascending.
        rate_hz: Of the videos.
    """
    chosen = list(frames)
    truth = dict(zip(_keys(joints), to_numpy(joints["joints_world_mm"]).reshape(-1, NUM_JOINTS, 3), strict=True))
    counts = _num_views(views)
    unseen = np.full(NUM_JOINTS, 0 if counts else ENOUGH_VIEWS, dtype=np.int64)
    world = np.full((len(chosen), len(HANDS), NUM_JOINTS, 3), np.nan)
    is_valid = np.zeros(world.shape[:-1], dtype=bool)
    for index, frame in enumerate(chosen):
        rng = np.random.default_rng([zlib.crc32(recording.encode()), frame, _STREAM])
        seen = np.stack([counts.get((frame, hand), unseen) for hand in HANDS])
        errors = rng.normal(size=world.shape[1:]) * noise_mm(seen)[..., None]
        is_valid[index] = seen >= MIN_VIEWS
        true = np.stack([truth[frame, hand] for hand in HANDS])
        world[index] = np.where(is_valid[index][..., None], true + errors, np.nan)
    keys = np.array(chosen, dtype=np.int64) * (KEY_RATE_HZ // rate_hz)
    return JointAnnotations(keys, world, is_valid)


def _num_views(views: pa.Table) -> dict[tuple[int, str], Int64[np.ndarray, "joint=21"]]:
    """Count the exocentric pictures that show each joint."""
    is_exo = np.array([ego_serial(name) is None for name in views["camera_id"].to_pylist()], dtype=bool)
    is_visible: Bool[np.ndarray, "row joint"] = to_numpy(views["is_visible"]).reshape(-1, NUM_JOINTS)
    counts: dict[tuple[int, str], Int64[np.ndarray, "joint=21"]] = {}
    for key, visible, counted in zip(_keys(views), is_visible, is_exo, strict=True):
        if counted:
            counts[key] = counts.get(key, 0) + visible.astype(np.int64)
    return counts


def _keys(table: pa.Table) -> list[tuple[int, str]]:
    return list(zip(table["frame"].to_pylist(), table["hand"].to_pylist(), strict=True))
