"""What ``doctor`` says of recordings whose faults are known."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stages._contract import Context
from stages.audit_recording import STAGE, AuditRecordingConfig

CONFIG = AuditRecordingConfig(
    detector="exact",
    options={"exact": {}},
    num_frames=50,
    max_image_side_px=960,
    max_persons=3,
    association_px=40.0,
    max_shift_frames=5,
    min_seen_fraction=0.5,
    sync_gain=0.8,
    max_offset_px=15.0,
)
Findings = dict[tuple[str, str], dict[str, Any]]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, world: Any, walk: Any) -> Callable[..., Findings]:
    """Return the stage on a long walk: findings by check and camera."""
    world.body_mm = walk(60)

    def run_stage(detector: Any, views: Any = None, **how: Any) -> Findings:
        monkeypatch.setattr("stages.audit_recording.create_body_detector", lambda name, **options: detector)
        inputs = {"views": world.views() if views is None else views}
        rows = STAGE.run(CONFIG.model_copy(update=how), inputs, Context(Path(), "s"))["audit"].to_pylist()
        return {(row["check"], row["camera_id"]): row for row in rows}

    return run_stage


def _levels(found: Findings, check: str) -> dict[str, str]:
    return {camera: row["level"] for (name, camera), row in found.items() if name == check}


def test_a_sound_recording_is_ok_all_over(run: Any, exact_bodies: Any) -> None:
    detector = exact_bodies()
    found = run(detector)
    assert {row["level"] for row in found.values()} == {"ok"}
    assert len(found) == 4 + 1 + 3 * 4  # files, the person, and three checks of each view
    assert found["file", "a"]["note"] == "640×480, 60 frames at 30 Hz" and found["file", "a"]["value"] == 60
    assert sorted({frame for _, frame in detector.asked}) == list(range(5, 55))  # the middle
    assert found["person", "all"]["note"].startswith("followed the only person: seen in 4.0 of 4 views")
    assert found["person seen", "b"]["note"] == "agrees with the other views in 100% of the frames"


def test_a_late_view_is_named_with_the_remedy(run: Any, exact_bodies: Any) -> None:
    found = run(exact_bodies(late={"b": 3}))
    assert _levels(found, "synchronisation") == {"a": "ok", "b": "warning", "c": "ok", "d": "ok"}
    row = found["synchronisation", "b"]
    assert row["value"] == 3.0 and row["note"].startswith("fits the others better when shifted by -3 frames")
    assert _levels(found, "calibration")["b"] == "ok"


def test_a_view_that_was_moved_is_named(run: Any, exact_bodies: Any) -> None:
    found = run(exact_bodies(offset_px={"c": (-22.0, 9.0)}))
    assert _levels(found, "calibration") == {"a": "ok", "b": "ok", "c": "warning", "d": "ok"}
    row = found["calibration", "c"]
    assert row["value"] == pytest.approx(np.hypot(22, 9), abs=1.5)
    assert "22 px right, +9 px down" in row["note"] and row["note"].endswith("zoomed after the calibration?")
    assert set(_levels(found, "synchronisation").values()) == {"ok"}


def test_a_view_that_rarely_sees_the_person_is_a_warning(run: Any, exact_bodies: Any) -> None:
    found = run(exact_bodies(is_hidden=lambda camera, frame: range(17) if camera == "d" and frame > 20 else ()))
    assert _levels(found, "person seen") == {"a": "ok", "b": "ok", "c": "ok", "d": "warning"}
    assert found["person seen", "d"]["value"] == pytest.approx(16 / 50)


def test_nobody_is_an_error(run: Any, exact_bodies: Any) -> None:
    found = run(exact_bodies(is_hidden=lambda camera, frame: range(17)))
    assert found["person", "all"]["level"] == "error" and found["person", "all"]["value"] == 0.0
    assert set(_levels(found, "person seen").values()) == {"warning"}
    assert set(_levels(found, "synchronisation").values()) == {"warning"}
    assert not _levels(found, "calibration")


def test_views_that_ingest_refused_are_errors_and_left_out(run: Any, world: Any, exact_bodies: Any) -> None:
    found = run(exact_bodies(), views=world.views({"c": "unreadable_video"}, note="it is no video"))
    assert _levels(found, "file") == {"a": "warning", "b": "warning", "c": "error", "d": "warning"}
    assert found["file", "c"]["note"].startswith("unreadable_video: this view is left out.")
    assert _levels(found, "person seen") == {"a": "ok", "b": "ok", "d": "ok"}


def test_two_views_cannot_tell_which_one_is_late(run: Any, world: Any, exact_bodies: Any) -> None:
    found = run(exact_bodies(), views=world.views({"c": "missing_video", "d": "missing_video"}))
    assert _levels(found, "synchronisation") == {"a": "warning", "b": "warning"}
    assert found["synchronisation", "a"]["note"].startswith("cannot be told")
    assert found["person", "all"]["level"] == "ok"


def test_a_recording_shorter_than_the_look_is_looked_at_whole(run: Any, world: Any, exact_bodies: Any) -> None:
    world.body_mm = world.body_mm[:3]
    detector = exact_bodies()
    found = run(detector)
    assert sorted({frame for _, frame in detector.asked}) == [0, 1, 2]
    assert found["person seen", "a"]["value"] == 1.0
