"""Read which 2D keypoints people set by hand, chunk by chunk: so one more runs nothing again but its own chunk."""

from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pyarrow.compute as pc
from pydantic import Field

from assemblyhands_core.data.camera_rows import valid_cameras
from assemblyhands_core.data.catalog import CHUNKS, CORRECTIONS, SOURCES, VIEWS
from assemblyhands_core.data.correction_file import Correction, check_corrections, read_corrections
from stages._contract import Context, Stage, StageConfig, Tables


class ReadCorrectionsConfig(StageConfig):
    """Parameters of reading."""

    weight: float = Field(ge=1)


def run(config: ReadCorrectionsConfig, inputs: Tables, context: Context) -> Tables:
    """Check the whole file, and return what is about one chunk.

    Raises:
        ValueError: Anything in the file is malformed, or about something that the recording has not.
    """
    (source,) = inputs["sources"].to_pylist()
    (chunk,) = inputs["chunks"].to_pylist()
    corrections = read_corrections(Path(source["source_file"]))
    used = inputs["views"].filter(pc.field("valid"))
    num_frames = pc.max(used["num_frames"]).as_py() or 0
    check_corrections(source["source_file"], corrections, context.sequence_id, valid_cameras(used), num_frames)
    frames = range(chunk["first_frame"], chunk["first_frame"] + chunk["num_frames"])
    own = sorted((c for c in corrections if c.frame in frames), key=lambda c: c.key)
    return {"corrections": CORRECTIONS.from_rows(list(_rows(own, config.weight)))}


def _rows(corrections: Iterable[Correction], weight: float) -> Iterator[dict[str, Any]]:
    for correction in corrections:
        yield {**asdict(correction), "corrected_px": [correction.x_px, correction.y_px], "weight": weight}


STAGE = Stage(
    name="read_corrections",
    version=1,
    config=ReadCorrectionsConfig,
    inputs={"sources": SOURCES, "chunks": CHUNKS, "views": VIEWS},
    outputs={"corrections": CORRECTIONS},
    run=run,
    shard="chunk",
    is_quick=True,
)
