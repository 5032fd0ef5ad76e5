"""The simulator's truth about a recording, for the stages that evaluate: no other may read it."""

from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from assemblyhands_core.data.ground_truth import TRUE_INSTANTS, TRUE_JOINTS, read_ground_truth


def read_truth(files: pa.Table, sequence_id: str) -> tuple[pa.Table, pa.Table]:
    """Return the tables `ground_truth.TRUE_JOINTS` and `TRUE_INSTANTS` of a recording.

    Raises:
        ValueError: The files are in several folders, or of another recording.
    """
    folders = {Path(path).parent for path in files["source_file"].to_pylist()}
    if len(folders) != 1:
        raise ValueError(f"sequence {sequence_id}: its ground truth is in {len(folders)} folders; give one.")
    (folder,) = folders
    joints, instants = (read_ground_truth(folder, spec) for spec in (TRUE_JOINTS, TRUE_INSTANTS))
    if (named := set(pc.unique(joints["sequence_id"]).to_pylist())) != {sequence_id}:
        raise ValueError(f"{folder} holds the truth of {', '.join(sorted(named))} instead of {sequence_id}.")
    return joints, instants
