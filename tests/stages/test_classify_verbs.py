"""Verbs told by a network whose answer is known, and how far the poses are off."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import torch
from verb_clips import NUM_INSTANTS, VERBS, clip_table, moving_clip, moving_table, unseen_clip

from assemblyhands_core.data.fine_grained import VERBS as ALL_VERBS
from assemblyhands_core.data.pose_clips import PoseClip
from assemblyhands_core.data.pose_sequences import PoseSequenceConfig
from assemblyhands_core.data.training_tables import WEIGHTS
from assemblyhands_core.data.verb_tables import VERB_CLIPS
from assemblyhands_core.models.msg3d import MSG3D, MSG3DConfig
from assemblyhands_core.models.pretrained import save_weights
from assemblyhands_core.models.verb_classification import VerbClassifier
from stages._contract import Context
from stages.classify_verbs import STAGE, ClassifyVerbsConfig, wrist_relative_error_mm

TINY = MSG3DConfig(num_classes=3, num_gcn_scales=2, num_g3d_scales=2, c1=6, c2=6, c3=12, num_frame_features=2)
IDS = [ALL_VERBS.index(verb) for verb in VERBS]
SEQUENCE = PoseSequenceConfig(30, 0, 16, "fit", "segment", "bones")


def _weights(folder: Path, is_fixed: bool) -> pa.Table:
    """Of a network that was never trained; a fixed one looks at nothing but objects: bolts are screwed to 75 %."""
    torch.manual_seed(0)
    network, path = MSG3D(TINY).eval(), folder / "net.safetensors"
    if is_fixed:
        with torch.no_grad():
            network.classifier.weight.zero_()
            network.classifier.bias.zero_()
            network.classifier.weight[1, TINY.c3] = float(np.log(6.0))
    save_weights(path, network, VerbClassifier.card(VERBS, ("bolt", "wheel"), SEQUENCE))
    return WEIGHTS.from_rows(
        [{"sequence_id": "s", "network": "MSG3D", "weights_file": str(path), "sha256": "", "card": "{}"}]
    )


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> pa.Table:
    return _weights(tmp_path_factory.mktemp("net"), is_fixed=False)


def _run(
    clips: pa.Table,
    weights: pa.Table,
    reference: pa.Table | None = None,
    noise_mm: float = 0.0,
    batch_size: int = 4,
    seed: int = 0,
) -> pa.Table:
    config = ClassifyVerbsConfig(batch_size=batch_size, noise_mm=noise_mm, noise_seed=seed)
    inputs = {"clips": clips, "reference": clips if reference is None else reference, "weights": weights}
    return STAGE.run(config, inputs, Context(Path(), "s", 2))["predictions"]


def _moved(clip: PoseClip, node: int, by_mm: tuple[float, float, float]) -> PoseClip:
    nodes = clip.nodes_mm.copy()
    nodes[:, :, node] += np.array(by_mm, dtype=np.float32)
    return PoseClip(nodes, clip.observed, clip.is_interpolated, clip.graph)


def test_a_network_with_a_known_answer_gives_it(tmp_path: Path) -> None:
    clips = [moving_clip(verb, number) for number, verb in enumerate(VERBS)]
    table = clip_table("s", VERBS, clips, ["bolt", "bolt", "anvil"])
    rows = _run(table, _weights(tmp_path, is_fixed=True)).to_pylist()
    assert [(row["sequence_id"], row["segment"], row["verb"], row["first_key"]) for row in rows] == [
        ("s", 0, "pick up", 0), ("s", 1, "screw", 100), ("s", 2, "remove", 200),
    ]  # fmt: skip
    assert [row["predicted"] for row in rows] == ["screw", "screw", "pick up"]  # of equals the first one
    np.testing.assert_allclose(np.array(rows[0]["probability"])[IDS], [1 / 8, 6 / 8, 1 / 8], atol=1e-6)
    assert sum(rows[0]["probability"]) == pytest.approx(1.0, abs=1e-6) and len(rows[0]["probability"]) == 24
    np.testing.assert_allclose([row["confidence"] for row in rows], [0.75, 0.75, 1 / 3], atol=1e-6)
    assert [row["coverage"] for row in rows] == [100.0] * 3


def test_where_nothing_was_seen_there_is_no_prediction(weights: pa.Table) -> None:
    table = clip_table("s", VERBS, [moving_clip("pick up", 0), unseen_clip(), moving_clip("remove", 2)])
    first, unseen, last = _run(table, weights).to_pylist()
    assert unseen["predicted"] == "" and unseen["verb"] == "screw" and unseen["coverage"] == 0.0
    assert np.isnan([unseen["confidence"], unseen["pose_error_mm"], *unseen["probability"]]).all()
    for row, number in ((first, 0), (last, 2)):  # those beside it are as without it
        (alone,) = _run(clip_table("s", VERBS[number:][:1], [moving_clip(VERBS[number], number)]), weights).to_pylist()
        np.testing.assert_allclose(row["probability"], alone["probability"], atol=1e-6)
        assert row["predicted"] == ALL_VERBS[int(np.argmax(row["probability"]))]
    assert _run(VERB_CLIPS.empty(), weights).num_rows == 0
    nothing = _run(clip_table("s", ["screw"], [unseen_clip()]), weights)
    assert nothing["predicted"].to_pylist() == [""]


def test_a_network_that_was_not_trained_says_nothing() -> None:
    assert _run(moving_table("s", 4), WEIGHTS.empty()).num_rows == 0


def test_the_pose_error_is_the_mean_distance_with_wrists_at_the_origin(weights: pa.Table) -> None:
    true = moving_clip("screw", 1)
    everywhere = PoseClip(true.nodes_mm + np.float32(500.0), true.observed, true.is_interpolated, true.graph)
    cases = {
        0.0: everywhere,  # where in the room it is does not count
        10.0 / 21: _moved(true, 4, (6.0, 0.0, 8.0)),  # one node of 21
        10.0 * 20 / 21: _moved(true, 20, (0.0, 10.0, 0.0)),  # the wrist: all others are off
    }
    for expected, clip in cases.items():
        found = _run(clip_table("s", ["screw"], [clip]), weights, clip_table("s", ["screw"], [true])).to_pylist()
        assert found[0]["pose_error_mm"] == pytest.approx(expected, abs=1e-4)


def test_only_hands_that_both_saw_count_for_the_error() -> None:
    true, off = moving_clip("screw", 1), _moved(moving_clip("screw", 1), 4, (21.0, 0.0, 0.0))
    observed = true.observed.copy()
    observed[:, 1], observed[:8, 0] = False, False
    nodes = np.where(observed[..., None, None], true.nodes_mm, off.nodes_mm)
    nodes[:, 1] = np.nan
    half = PoseClip(nodes, observed, ~observed & [True, False], true.graph)
    assert wrist_relative_error_mm(half, true) == wrist_relative_error_mm(true, half) == 0.0
    assert wrist_relative_error_mm(half, off) == pytest.approx(1.0, abs=1e-5)
    assert np.isnan(wrist_relative_error_mm(unseen_clip(), true)) and np.isnan(wrist_relative_error_mm(true, None))
    shorter = PoseClip(true.nodes_mm[:9], true.observed[:9], true.is_interpolated[:9], true.graph)
    assert np.isnan(wrist_relative_error_mm(shorter, true))
    assert np.isnan(wrist_relative_error_mm(moving_clip("screw", 1, "landmarks"), true))


def test_segments_are_compared_by_their_numbers(weights: pa.Table) -> None:
    table = moving_table("s", 4)
    shuffled = _run(table, weights, table.take(np.arange(table.num_rows)[::-1]))["pose_error_mm"].to_pylist()
    assert shuffled == [0.0] * 4
    (missing, there) = _run(table.slice(0, 2 * NUM_INSTANTS), weights, table.slice(NUM_INSTANTS))[
        "pose_error_mm"
    ].to_pylist()
    assert np.isnan(missing) and there == 0.0


def test_noise_makes_the_error_that_theory_gives(weights: pa.Table) -> None:
    """A node less its wrist has the standard deviation sqrt(2) s along each axis, its mean distance is
    sqrt(8 / pi) times that; the wrist's own is 0.
    """
    table = moving_table("s", 40)
    for noise_mm in (3.0, 12.0):
        found = np.array(_run(table, weights, noise_mm=noise_mm)["pose_error_mm"].to_pylist())
        expected = 20 / 21 * noise_mm * np.sqrt(2) * np.sqrt(8 / np.pi)
        # 40 clips of 16 × 2 hands, whose 20 nodes share the noise of their wrist.
        assert found.mean() == pytest.approx(expected, rel=0.01) and 0.01 < found.std() / expected < 0.1
    quiet, noisy = (_run(table, weights, noise_mm=noise)["probability"].to_pylist() for noise in (0.0, 12.0))
    assert not np.allclose(quiet, noisy)


def test_noise_belongs_to_the_segment_whatever_the_order_of_rows(weights: pa.Table) -> None:
    table = moving_table("s", 6)
    order = np.random.default_rng(0).permutation(table.num_rows)
    found, turned = (_run(rows, weights, table, noise_mm=5.0) for rows in (table, table.take(order)))
    assert found.equals(turned)
    (alone,) = _run(table.slice(2 * NUM_INSTANTS, NUM_INSTANTS), weights, table, noise_mm=5.0).to_pylist()
    assert alone["segment"] == 2 and alone["pose_error_mm"] == found["pose_error_mm"][2].as_py()
    errors = found["pose_error_mm"].to_pylist()
    assert len(set(errors)) == 6
    assert errors != _run(table, weights, table, noise_mm=5.0, seed=1)["pose_error_mm"].to_pylist()


def test_batches_do_not_matter(weights: pa.Table) -> None:
    table = moving_table("s", 7)
    found = _run(table, weights, batch_size=7)
    assert np.std(np.stack(found["probability"].to_pylist()), axis=0)[IDS].min() > 1e-5
    for batch_size in (1, 3):
        other = _run(table, weights, batch_size=batch_size)
        for name in ("probability", "confidence"):
            one, same = (np.stack(rows[name].to_pylist()) for rows in (found, other))
            np.testing.assert_allclose(same, one, rtol=0, atol=1e-5)


def test_clips_that_the_network_does_not_take_are_refused(weights: pa.Table) -> None:
    with pytest.raises(ValueError, match="the network takes clips of 30 Hz, these are of 15 Hz: cut them anew"):
        _run(moving_table("s", 2, rate_hz=15), weights)
    landmarks = clip_table("s", ["screw"], [moving_clip("screw", 0, "landmarks")])
    with pytest.raises(ValueError, match="the clip has nodes of the graph 'landmarks', the network takes 'skeleton'"):
        _run(landmarks, weights)
