"""Corrections reach the chunks that they are about alone; a file that is wrong anywhere is refused everywhere."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from assemblyhands_core.data.catalog import CHUNKS, CORRECTIONS, SOURCES
from assemblyhands_core.data.correction_file import Correction, write_corrections
from stages._contract import Context
from stages.read_corrections import STAGE, ReadCorrectionsConfig


def _point(frame: int, camera_id: str, joint: str = "wrist", visibility: int = 2) -> Correction:
    place = (20.0, 30.5) if visibility else (np.nan, np.nan)
    return Correction("s", frame, camera_id, "left", joint, *place, visibility)


def _run(path: Path, views: pa.Table, chunk: int) -> pa.Table:
    source = {"sequence_id": "s", "role": "corrections", "name": "corrections", "source_file": str(path), "sha256": ""}
    first = {"sequence_id": "s", "chunk": chunk, "first_frame": 2 * chunk, "num_frames": 2}
    inputs = {"sources": SOURCES.from_rows([source]), "chunks": CHUNKS.from_rows([first]), "views": views}
    return STAGE.run(ReadCorrectionsConfig(weight=8.0), inputs, Context(Path(), "s"))["corrections"]


def test_each_chunk_gets_its_own_and_equal_ones_whatever_the_others_have(world: Any, tmp_path: Path) -> None:
    name, path = world.cameras[0].camera_id, tmp_path / "s.csv"
    write_corrections(path, [_point(2, name), _point(3, name, "index_tip", 0)])
    views, before = world.views(), _run(path, world.views(), 1)
    assert [row["joint"] for row in before.to_pylist()] == ["wrist", "index_tip"]
    wrist, tip = before.to_pylist()
    assert (wrist["corrected_px"], wrist["visibility"], wrist["weight"]) == ([20.0, 30.5], 2, 8.0)
    assert tip["visibility"] == 0 and np.isnan(tip["corrected_px"]).all()
    assert _run(path, views, 0).num_rows == 0
    write_corrections(path, [_point(0, name), _point(3, name, "index_tip", 0), _point(2, name)])
    assert CORRECTIONS.digest(_run(path, views, 1)) == CORRECTIONS.digest(before)
    assert _run(path, views, 0).num_rows == 1


@pytest.mark.parametrize("chunk", [0, 1])
def test_a_file_about_something_else_is_refused_by_every_chunk(world: Any, tmp_path: Path, chunk: int) -> None:
    write_corrections(tmp_path / "s.csv", [_point(0, "nowhere")])
    with pytest.raises(ValueError, match="left wrist in nowhere at frame 0: unknown_view"):
        _run(tmp_path / "s.csv", world.views(), chunk)
