import errno
import shutil
from typing import Any

import pytest

from assemblyhands_core.data.entry_records import Record
from assemblyhands_core.data.store import Store
from pipeline.config import UserError
from pipeline.graph import SOURCE_EDGE, TRUTH_EDGE
from pipeline.work import possible_nodes


def test_a_sequence_reads_its_chunks_in_order_whichever_were_there(toy: Any) -> None:
    first = {f"{r.node} {r.shard}": r for r in toy.run()}
    shutil.rmtree(toy.store.entry("multiply", first["times one.00000"].key))
    assert toy.status(toy.run()) == {
        "cut one": "reused", "times one.00000": "done", "times one.00001": "reused", "total one": "reused",
    }  # fmt: skip


def test_a_damaged_cutting_table_is_made_anew(toy: Any) -> None:
    first = {f"{r.node} {r.shard}": r for r in toy.run()}
    chunks = toy.store.entry("cut", first["cut one"].key) / "chunks.parquet"
    record = chunks.with_name("record.json")
    content = bytearray(chunks.read_bytes())
    content[len(content) // 4] ^= 0xFF
    chunks.write_bytes(bytes(content))
    record.touch()  # so that only reading finds it
    statuses = toy.status(toy.run())
    assert statuses["cut one"] == "done" and statuses["total one"] == "reused"


def test_a_cutting_table_that_is_not_to_be_seen_fails_its_sequence_alone(
    toy: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on NFS, where what another host made may be seen late."""
    toy.record("two", 7, 8)
    real, unseen = Store.find, [True]

    def find(store: Store, stage: str, key: str) -> Record | None:
        record = real(store, stage, key)
        is_of_one = record is not None and stage == "cut" and record.outputs["numbers"].num_rows == 5
        return None if is_of_one and unseen else record

    monkeypatch.setattr(Store, "find", find)
    found = {f"{r.node} {r.shard}": r for r in toy.run()}
    failed = found["cut one"]
    assert failed.status == "failed" and failed.is_repairable and "has vanished; run again" in failed.error
    assert found["times one"].status == "blocked" and found["total two"].status == "done"
    unseen.clear()
    assert toy.status(toy.run())["cut one"] == "reused" and toy.total("one") == 30


def test_a_cutting_table_that_cannot_be_read_now_fails_its_sequence_alone(
    toy: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read(*arguments: Any) -> None:
        raise OSError(errno.EMFILE, "Too many open files", "chunks.parquet")

    toy.record("two", 7, 8)
    with monkeypatch.context() as patched:
        patched.setattr(Store, "read", read)
        found = {f"{r.node} {r.shard}": r for r in toy.run()}
    assert found["cut one"].error == "[Errno 24] Too many open files: 'chunks.parquet'"
    assert found["cut one"].status == "failed" and not found["cut one"].is_repairable
    assert toy.status(toy.run())["cut one"] == "reused"


def test_another_truth_runs_nothing_but_what_reads_it(toy: Any) -> None:
    assert "error one" not in toy.status(toy.run())
    toy.know("one", 30.0)
    statuses = toy.status(toy.run())
    assert statuses.pop("error one") == "done" and set(statuses.values()) == {"reused"}
    toy.know("one", 29.0)
    statuses = toy.status(toy.run())
    assert statuses.pop("error one") == "done" and set(statuses.values()) == {"reused"}
    assert set(toy.status(toy.run()).values()) == {"reused"}


def test_sequences_with_and_without_truth_run_side_by_side(toy: Any) -> None:
    toy.record("two", 7, 8)
    toy.know("two", 30.0)
    statuses = toy.status(toy.run())
    assert {"total one", "total two", "error two"} < set(statuses) and "error one" not in statuses
    assert set(statuses.values()) == {"done"}


def test_asking_for_nothing_but_what_needs_truth_is_refused_without_it(toy: Any) -> None:
    config = toy.config().model_copy(update={"target": "error"})
    with pytest.raises(UserError, match="sequence one comes without truth, which target=error needs"):
        possible_nodes(config, "one", {SOURCE_EDGE: [{}], TRUTH_EDGE: []})
    assert [node.name for node in possible_nodes(config, "one", {SOURCE_EDGE: [{}], TRUTH_EDGE: [{}]})][-1] == "error"


def test_what_is_about_all_sequences_is_left_out_where_none_has_what_it_reads(toy: Any) -> None:
    toy.targets = ("total", "mean", "mean_error")
    assert "mean_error all-sequences" not in toy.status(toy.run())
    toy.know("one", 30.0)
    statuses = toy.status(toy.run())
    assert statuses["mean_error all-sequences"] == "done" and statuses["mean all-sequences"] == "reused"


def test_it_is_refused_where_nothing_else_is_asked_for(toy: Any) -> None:
    toy.targets = ("mean_error",)
    with pytest.raises(UserError, match="no sequence of this run has error, which mean_error needs"):
        toy.run()


def test_a_sequence_can_be_cut_in_two_ways_at_once(toy: Any) -> None:
    toy.targets = ("both",)
    statuses = toy.status(toy.run())
    assert {"times one.00001", "times_finer one.00004", "both one"} <= set(statuses)
    assert sum(name.startswith("times one") for name in statuses) == 2
    assert sum(name.startswith("times_finer one") for name in statuses) == 5
    assert set(statuses.values()) == {"done"}
    assert set(toy.status(toy.run()).values()) == {"reused"}
