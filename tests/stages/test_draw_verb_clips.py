"""Clips that are drawn show what the studio's script says, when it says so."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import yaml

from assemblyhands_core.data.catalog import CHUNKS
from assemblyhands_core.data.fine_grained import PAPER_VERBS
from assemblyhands_core.data.studio_tables import CROP_ORDERS
from assemblyhands_core.data.verb_clip_rows import clips_of
from assemblyhands_core.hands.graphs import graph_nodes
from assemblyhands_core.synthetic.crop_draws import draw_training_take, training_subject
from assemblyhands_core.synthetic.take import Take
from stages._contract import Context
from stages.draw_verb_clips import STAGE, DrawVerbClipsConfig

CONF = Path(__file__).parents[2] / "conf" / "stage" / "draw_verb_clips.yaml"
CHUNK, DURATION_S = 3, 4.0


def _run(chunk: int = CHUNK, **changes: Any) -> pa.Table:
    config = DrawVerbClipsConfig.model_validate({**yaml.safe_load(CONF.read_text()), **changes})
    order = {"sequence_id": "set", "split": "val", "rig": "assembly", "duration_s": 240.0, "package": "crops"}
    cut = {"sequence_id": "set", "chunk": chunk, "first_frame": 10 * chunk, "num_frames": 10}
    inputs = {"orders": CROP_ORDERS.from_rows([order]), "chunks": CHUNKS.from_rows([cut])}
    return STAGE.run(config, inputs, Context(Path(), "set"))["clips"]


@pytest.fixture(scope="module", autouse=True)
def _short_takes() -> Iterator[None]:
    """Draw the beginnings of takes: a shorter one is the beginning of a longer one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("stages.draw_verb_clips.draw_training_take", partial(draw_training_take, duration_s=DURATION_S))
        yield


@pytest.fixture(scope="module")
def clips() -> pa.Table:
    return _run()


@pytest.fixture(scope="module")
def take() -> Take:
    drawn = draw_training_take(training_subject("val", CHUNK), CHUNK, "assembly", duration_s=DURATION_S)
    return Take.from_seed(drawn.subject, drawn.take_seed, drawn.duration_s, drawn.kind)


def test_segments_are_the_scripts(clips: pa.Table, take: Take) -> None:
    said = {(s.verb, s.noun, round(60 * s.start_s), round(60 * s.end_s) - 1) for s in take.segments}
    found = [(one.verb, one.noun, one.first_key, one.last_key) for one, _ in clips_of(clips)]
    assert set(found) == said and len(found) == len(said) >= 2
    assert {verb for verb, *_ in found} <= set(PAPER_VERBS)
    assert set(clips["sequence_id"].to_pylist()) == {"set"} and set(clips["rate_hz"].to_pylist()) == {30}


def test_poses_are_the_takes_at_their_instants(clips: pa.Table, take: Take) -> None:
    for segment, clip in clips_of(clips):
        first = max(int(np.ceil((segment.first_key - 25) / 2)), 0)  # with its context, at 30 Hz
        last = min((segment.last_key + 25) // 2, round(30 * take.duration_s) - 2)  # that the take has at 15 Hz
        assert len(clip) == last + 1 - first and clip.is_present.all()
        for instant in range(first % 2, len(clip), 9):
            joints = take.joints_at((first + instant) / 30).reshape(2, 21, 3)
            # Sampled at 15 Hz: every other instant is the take's own, those between lie on a straight line.
            atol = 1e-3 if (first + instant) % 2 == 0 else 15.0
            np.testing.assert_allclose(clip.nodes_mm[instant], joints, rtol=0, atol=atol)


def test_chunks_are_other_takes_and_share_no_segment_number(clips: pa.Table) -> None:
    other = _run(CHUNK + 1, graph="landmarks")
    assert not set(clips["segment"].to_pylist()) & set(other["segment"].to_pylist())
    assert [segment.number for segment, _ in clips_of(clips)] == list(range(3000, 3000 + len(clips_of(clips))))
    assert set(other["graph"].to_pylist()) == {"landmarks"}
    same_nodes = graph_nodes(clips_of(clips)[0][1].nodes_mm, "landmarks")
    assert np.abs(clips_of(other)[0][1].nodes_mm[0] - same_nodes[0]).max() > 10.0


def test_equal_orders_give_equal_bytes(clips: pa.Table) -> None:
    assert _run().equals(clips)
