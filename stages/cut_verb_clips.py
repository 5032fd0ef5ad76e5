"""Cut poses into the segments in which one of the chosen verbs is done (paper, Sec. 5).

The poses may be anybody's: our annotation, people's, or those that were found in the headset's pictures.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
from pydantic import Field

from assemblyhands_core.data.assemblyhands import KEY_RATE_HZ
from assemblyhands_core.data.catalog import JOINTS, SOURCES, VIEWS
from assemblyhands_core.data.fine_grained import read_fine_grained
from assemblyhands_core.data.label_rows import first_key_of, keys_per_frame, read_recording
from assemblyhands_core.data.pose_clips import cut_clip
from assemblyhands_core.data.verb_clip_rows import clip_rows, tracks_of_joints
from assemblyhands_core.data.verb_segments import VerbSegments, VerbSelection, select_verb_segments
from assemblyhands_core.data.verb_tables import VERB_CLIPS, VERB_PROBLEMS
from assemblyhands_core.hands.graphs import GraphName
from stages._contract import Context, Stage, StageConfig, Tables

NO_POSES = "no_poses"
"""The reason that counts segments which are kept without any hand observed."""


class CutVerbClipsConfig(StageConfig):
    """Parameters of cutting."""

    verbs: tuple[str, ...]
    min_rate_hz: float = Field(ge=0)
    min_duration_s: float = Field(ge=0)
    max_overlap: float = Field(ge=0, le=1)
    is_overlap_dropped: bool
    rate_hz: int = Field(ge=1, le=KEY_RATE_HZ)
    context_keys: int = Field(ge=0)
    graph: GraphName
    first_key: int | None = Field(ge=0)

    def selection(self) -> VerbSelection:
        """Return which segments are chosen."""
        return VerbSelection(self.verbs, self.min_duration_s, self.max_overlap, self.is_overlap_dropped)


def run(config: CutVerbClipsConfig, inputs: Tables, context: Context) -> Tables:
    """Cut one sequence; a segment without poses has a clip in which no hand is observed.

    Raises:
        ValueError: No camera can be used, so that nobody knows how long the video is.
    """
    sources, video = inputs["actions"].to_pylist(), inputs["views"].filter(pc.field("valid"))
    if not video.num_rows:
        raise ValueError(f"sequence {context.sequence_id}: no view can be used; table views says why of each.")
    num_frames, rate_hz = int(pc.max(video["num_frames"]).as_py()), float(video["rate_hz"][0].as_py())
    step = keys_per_frame(rate_hz)
    first_key = _first_key(sources, context) if config.first_key is None else config.first_key
    keys = range(first_key, first_key + step * num_frames)
    (actions,) = (row["source_file"] for row in sources if row["role"] == "actions")
    found = select_verb_segments(read_fine_grained(Path(actions)), config.selection(), {context.sequence_id: keys})
    tracks = tracks_of_joints(inputs["joints"], num_frames, step, first_key, config.graph)
    segments = found.segments if rate_hz >= config.min_rate_hz else ()
    clips = [cut_clip(tracks, s.first_key, s.last_key, config.rate_hz, config.context_keys) for s in segments]
    pairs = zip(segments, clips, strict=True)
    rows = [row for segment, clip in pairs for row in clip_rows(segment, clip, config.rate_hz)]
    lacking = {
        NO_POSES: sum(not clip.observed.any() for clip in clips),
        "too_few_frames": len(found.segments) - len(segments),
    }
    return {"clips": VERB_CLIPS.from_rows(rows), "problems": _problems(found, lacking, context)}


def _first_key(sources: Sequence[Mapping[str, Any]], context: Context) -> int:
    """Return the key of frame 0: of the release's pictures that of the first label, else 0."""
    labels = next((row for row in sources if row["role"] == "labels"), None)
    return first_key_of(labels, read_recording(labels, context.sequence_id)) if labels else 0


def _problems(found: VerbSegments, lacking: Mapping[str, int], context: Context) -> pa.Table:
    """Return how many segments were left out or are odd, by reason, and each sentence about one."""
    counts = [*found.dropped.items(), *found.noted.items(), *(item for item in lacking.items() if item[1])]
    rows: list[dict[str, Any]] = [{"reason": str(name), "count": number, "sentence": ""} for name, number in counts]
    rows += [{"reason": "", "count": n, "sentence": sentence} for sentence, n in Counter(found.problems).items()]
    return VERB_PROBLEMS.from_rows([{"sequence_id": context.sequence_id, **row} for row in rows])


STAGE = Stage(
    name="cut_verb_clips",
    version=3,
    config=CutVerbClipsConfig,
    inputs={"actions": SOURCES, "views": VIEWS, "joints": JOINTS},
    outputs={"clips": VERB_CLIPS, "problems": VERB_PROBLEMS},
    run=run,
    shard="sequence",
)
