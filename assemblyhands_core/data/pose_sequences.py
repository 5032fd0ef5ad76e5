"""Clips of hand poses as a network for verbs takes them: fixed length, moved and scaled.

The paper follows Assembly101 and samples at 30 Hz, but gives neither length nor context for that rate; `REFERENCE` are
the parameters of Assembly101's own preparation at 60 Hz, which it reproduces to the bit (formats 3.8).
"""

from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64

from assemblyhands_core.data.assembly101_poses import Assembly101Poses
from assemblyhands_core.data.assemblyhands import KEY_RATE_HZ
from assemblyhands_core.data.pose_clips import PoseClip, PoseTracks, cut_clip
from assemblyhands_core.data.verb_segments import VerbSegment
from assemblyhands_core.hands.graphs import EDGES, JOINT_OF_LANDMARK, GraphName
from assemblyhands_core.hands.joints import HANDS, WRIST, Hand

Length = Literal["resample", "pad", "fit"]
Centre = Literal["none", "wrist", "segment"]
Scale = Literal["none", "bones"]

WRIST_NODE: Final[dict[GraphName, int]] = {"skeleton": WRIST, "landmarks": JOINT_OF_LANDMARK.index(WRIST)}
BONE_BOUNDS_MM: Final = (15.0, 80.0)
"""No human hand has shorter or longer bones on average: a scale from poses that went wrong stays within."""


@dataclass(frozen=True)
class PoseSequenceConfig:
    """How clips become the input of a network.

    Attributes:
        rate_hz: Of the time base (paper: 30).
        context_keys: 60 Hz frames that are added before and after a segment (reference: 25).
        num_frames: Length of the input.
        length: How clips come to it. `resample` stretches every clip, so that what is done is seen whole but not how
            fast; `pad` keeps the speed, adds zeros at the end and loses what is beyond (reference); `fit` pads short
            clips and resamples long ones.
        centre: What becomes the origin. `wrist` is each hand's own at each instant, and loses where the hands move;
            `segment` is one point for the whole clip, amid both hands' mean wrists: it loses only where in the room it
            was.
        scale: `bones` divides by the hands' mean bone length, so that large and small hands are alike.
        graph: Which nodes there are.
        hands: Their order.
    """

    rate_hz: int
    context_keys: int
    num_frames: int
    length: Length
    centre: Centre
    scale: Scale
    graph: GraphName = "skeleton"
    hands: tuple[Hand, Hand] = HANDS

    def __post_init__(self) -> None:
        """Refuse what makes no sequence."""
        if self.rate_hz < 1 or self.num_frames < 1 or self.context_keys < 0:
            raise ValueError(
                f"rate_hz={self.rate_hz}, num_frames={self.num_frames}, context_keys={self.context_keys}: rate and "
                "length have to be 1 or more, the context 0 or more."
            )
        if set(self.hands) != set(HANDS):
            raise ValueError(f"hands={self.hands}: name {HANDS[0]} and {HANDS[1]}, each once.")


REFERENCE: Final = PoseSequenceConfig(
    rate_hz=KEY_RATE_HZ,
    context_keys=25,
    num_frames=200,
    length="pad",
    centre="none",
    scale="none",
    graph="landmarks",
    hands=("left", "right"),
)


@dataclass(frozen=True, eq=False)
class PoseSequence:
    """The input of a network.

    Attributes:
        values: Zero where there is no pose.
        observed: Where a hand was measured.
        is_interpolated: Where it was not, but there is a pose; where neither holds there is none.
        num_frames: How many of the frames are of the clip; those after them are padding.
    """

    values: Float32[np.ndarray, "xyz=3 time node=21 hand=2"]
    observed: Bool[np.ndarray, "time hand=2"]
    is_interpolated: Bool[np.ndarray, "time hand=2"]
    num_frames: int


def build_sequence(
    joints_mm: Float[np.ndarray, "frame joint=42 xyz=3"],
    valid: Bool[np.ndarray, "frame joint=42"],
    times_s: Float64[np.ndarray, " frame"],
    segment: VerbSegment,
    config: PoseSequenceConfig,
) -> PoseSequence:
    """Return the input for one segment; for many of one recording, make its `PoseTracks` once and cut clips.

    Args:
        joints_mm: Of the whole recording, in our order, right hand first, in world coordinates.
        valid: Which joints are known.
        times_s: When each frame was; key 0 of 60 Hz is at 0 s.
        segment: Of this recording.
        config: What is wanted.
    """
    tracks = PoseTracks.of(joints_mm, valid, times_s, config.graph, config.hands)
    return sequence_of(segment_clip(tracks, segment, config), config)


def segment_clip(tracks: PoseTracks, segment: VerbSegment, config: PoseSequenceConfig) -> PoseClip:
    """Return a segment's poses with its context."""
    return cut_clip(tracks, segment.first_key, segment.last_key, config.rate_hz, config.context_keys)


def reference_tracks(poses: Assembly101Poses) -> PoseTracks:
    """Return the poses of Assembly101's tracker as they stand in the file, for `REFERENCE`."""
    return PoseTracks(poses.landmarks_world_mm, np.arange(len(poses)) / KEY_RATE_HZ, "landmarks")


def sequence_of(clip: PoseClip, config: PoseSequenceConfig) -> PoseSequence:
    """Return a clip as the input of a network.

    Raises:
        ValueError: The clip has the nodes of another graph than the network.
    """
    if clip.graph != config.graph:
        raise ValueError(f"the clip has nodes of the graph {clip.graph!r}, the network takes {config.graph!r}.")
    fitted = _fitted(clip, config)
    nodes = np.nan_to_num(_centred(fitted.nodes_mm, clip, config.centre) / _scale_mm(clip, config.scale))
    num_frames = len(fitted)
    values = np.zeros((3, config.num_frames, *nodes.shape[1:3][::-1]), dtype=np.float32)
    values[:, :num_frames] = nodes.transpose(3, 0, 2, 1)
    flags = np.zeros((2, config.num_frames, len(HANDS)), dtype=bool)
    flags[:, :num_frames] = fitted.observed, fitted.is_interpolated
    return PoseSequence(values, flags[0], flags[1], num_frames)


def _fitted(clip: PoseClip, config: PoseSequenceConfig) -> PoseClip:
    """Return the clip's instants that the network sees, at most as many as it takes."""
    count = config.num_frames
    is_stretched = {"resample": len(clip) > 0, "pad": False, "fit": len(clip) > count}[config.length]
    if is_stretched:
        return clip.at(np.linspace(0, len(clip) - 1, count))
    kept = slice(count)
    return replace(
        clip,
        nodes_mm=clip.nodes_mm[kept],
        observed=clip.observed[kept],
        is_interpolated=clip.is_interpolated[kept],
    )


def _centred(
    nodes_mm: Float[np.ndarray, "instant hand=2 node=21 xyz=3"], clip: PoseClip, centre: Centre
) -> Float[np.ndarray, "instant hand=2 node=21 xyz=3"]:
    wrist = WRIST_NODE[clip.graph]
    if centre == "wrist":
        return np.asarray(nodes_mm - nodes_mm[:, :, wrist, None])
    seen = clip.is_present.any(axis=0)
    if centre == "none" or not seen.any():
        return nodes_mm
    amid = clip.nodes_mm[:, seen, wrist].mean(axis=(0, 1), dtype=np.float64)
    return np.asarray(nodes_mm - amid.astype(np.float32))


def _scale_mm(clip: PoseClip, scale: Scale) -> np.float32:
    """Return what to divide by, one figure for both hands so that they keep their distance in proportion.

    The median over instants and hands of the mean bone length: single poses that went wrong do not enter.
    """
    if scale == "none" or not clip.observed.any():
        return np.float32(1.0)
    ends, starts = np.transpose(EDGES[clip.graph])
    poses = clip.nodes_mm[clip.observed]
    lengths = np.linalg.norm(poses[:, ends] - poses[:, starts], axis=-1).mean(axis=-1)
    return np.float32(np.clip(np.median(lengths), *BONE_BOUNDS_MM))
