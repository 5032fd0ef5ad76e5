"""The network of verbs by its command line: poses drawn in the studio, trained on, and told from those held out."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from command_line import Outcome, entries, new_stages, pipeline

from assemblyhands_core.data.store import load

pytestmark = pytest.mark.slow

TINY = (
    "train_verbs.num_gcn_scales=2", "train_verbs.num_g3d_scales=2", "train_verbs.num_channels=[6,6,12]",
    "train_verbs.num_frames=16", "train_verbs.num_epochs=1", "train_verbs.steps_per_epoch=2",
    "train_verbs.batch_size=8", "train_verbs.num_loaders=0", "draw_verb_clips.sampled_hz=5",
)  # fmt: skip


@dataclass(frozen=True)
class Trained:
    """What `verb_weights` left behind."""

    outcome: Outcome
    workspace: Path
    overrides: tuple[str, ...]

    @property
    def run(self) -> Path:
        return self.workspace / "runs" / "drawn"


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Trained:
    """A training on one take, judged by another person's."""
    folder = tmp_path_factory.mktemp("verbs")
    rows = [f"poses_{split},{split},,,crops,assembly,24" for split in ("train", "val")]
    (folder / "set.csv").write_text(
        "\n".join(["sequence_id,split,calibration,videos,package,rig,duration_s", *rows]) + "\n"
    )
    overrides = (f"manifest={folder / 'set.csv'}", "seq=all", "executor=serial", *TINY)
    outcome = pipeline("target=verb_weights", "run=drawn", *overrides, workspace=folder / "work")
    return Trained(outcome.assert_done(), folder / "work", overrides)


def test_poses_of_both_persons_become_clips(trained: Trained) -> None:
    clips = load(trained.run / "drawn_verb_clips")
    counts = clips.groupby("sequence_id").segment.nunique()
    assert set(counts.index) == {"poses_train", "poses_val"} and counts.min() >= 5
    nodes_mm = np.stack(clips.nodes_mm).reshape(-1, 2, 21, 3)
    assert np.isfinite(nodes_mm).all() and 50 < np.ptp(nodes_mm, axis=2).max(axis=-1).mean() < 250


def test_the_network_learns_from_one_and_is_judged_by_the_other(trained: Trained) -> None:
    counts = load(trained.run / "drawn_verb_clips").groupby(["sequence_id", "verb"]).segment.nunique()
    (row,) = load(trained.run / "drawn_verb_weights").to_dict("records")
    card = json.loads(row["card"])
    rare = sum(counts.get(("poses_train", verb), 0) for verb in ("screw", "unscrew"))
    assert card["samples"] == counts["poses_train"].sum() + 2 * rare  # these are shown three times
    assert card["held_out"] == counts["poses_val"].sum()
    assert json.loads(card["classifier"])["sequence"]["rate_hz"] == 30


def test_every_clip_is_told_a_verb(trained: Trained) -> None:
    clips, told = (load(trained.run / node) for node in ("drawn_verb_clips", "drawn_verbs"))
    clips = clips[clips.instant == 0]
    both = clips.merge(told, on=["sequence_id", "segment"], suffixes=("", "_told"))
    assert len(both) == len(clips) == len(told) and (both.verb == both.verb_told).all()
    assert set(told.predicted) <= {"pick up", "position", "screw", "put down", "remove", "unscrew"}
    assert np.allclose(np.stack(told.probability).sum(axis=1), 1.0, atol=1e-5)
    assert (told.pose_error_mm == 0).all()
    assert told.coverage.mean() == pytest.approx(100 / 6, rel=0.05)  # at 5 Hz each sixth instant is the script's


def test_again_costs_nothing_and_noise_only_the_classification(trained: Trained) -> None:
    before = entries(trained.workspace)
    overrides = (*trained.overrides, "classify_verbs.noise_mm=10")
    pipeline("target=verb_weights", "run=noisy", *overrides, workspace=trained.workspace).assert_done()
    assert new_stages(trained.workspace, before) == {"classify_verbs": 2}
    errors = load(trained.run.with_name("noisy") / "drawn_verbs").pose_error_mm
    assert errors.mean() == pytest.approx(20 / 21 * 10 * np.sqrt(16 / np.pi), rel=0.05)
