"""What a file for rerun holds, read back with rerun's own reader."""

from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest

chunks = pytest.importorskip("rerun.chunk", reason="rerun-sdk is not installed: pip install -e '.[view]'")

STATIC = None
"""The frame of what does not change."""


def read_rerun_file(path: Path) -> dict[str, dict[str, dict[int | None, Any]]]:
    """Return every value by entity, component and frame."""
    found: dict[str, dict[str, dict[int | None, Any]]] = defaultdict(lambda: defaultdict(dict))
    for chunk in chunks.RrdReader(path).stream():
        rows = chunk.to_record_batch().to_pydict()
        frames = [STATIC] * chunk.num_rows if chunk.is_static else rows["frame"]
        for name in (name for name in rows if ":" in name):
            found[chunk.entity_path][name] |= dict(zip(frames, rows[name], strict=True))
    return found


def read_seconds(path: Path, entity: str) -> dict[int, float]:
    """Return the time in seconds of an entity's frames."""
    found: dict[int, float] = {}
    for chunk in chunks.RrdReader(path).stream():
        if chunk.entity_path == entity and not chunk.is_static:
            rows = chunk.to_record_batch().to_pydict()
            found |= {f: t.total_seconds() for f, t in zip(rows["frame"], rows["time"], strict=True)}
    return found
