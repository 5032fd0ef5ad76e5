from pathlib import Path
from typing import Any

import numpy as np
import pytest
from true_hands import TRUE_MM, write_truth

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.catalog import CHUNKS
from stages._contract import Context, StageConfig
from stages.start_from_truth import STAGE


def _run(folder: Path, first_frame: int, num_frames: int, sequence_id: str = "s") -> Any:
    chunk = {"sequence_id": "s", "chunk": 1, "first_frame": first_frame, "num_frames": num_frames}
    inputs = {"truth": write_truth(folder, sequence_id), "chunks": CHUNKS.from_rows([chunk])}
    return STAGE.run(StageConfig(), inputs, Context(folder, "s"))["joints"]


def test_the_true_joints_of_a_chunk_are_given_once(tmp_path: Path) -> None:
    joints = _run(tmp_path, 3, 2)
    assert list(zip(joints["frame"].to_pylist(), joints["hand"].to_pylist(), strict=True)) == [
        (3, "right"), (3, "left"), (4, "right"), (4, "left")
    ]  # fmt: skip
    np.testing.assert_array_equal(to_numpy(joints["joints_world_mm"]).reshape(2, 2, 21, 3), TRUE_MM[3:5])
    assert to_numpy(joints["valid"]).all() and set(joints["round"].to_pylist()) == {100}


def test_the_truth_of_another_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="holds the truth of other instead of s"):
        _run(tmp_path, 0, 1, "other")
