import shutil
from dataclasses import replace
from typing import Any

import pyarrow as pa
import pytest

from assemblyhands_core.training.scratch import own_folder
from pipeline.tasks import Task, run_task
from stages._contract import Context, StageConfig, Tables


def test_a_first_run_computes_every_shard_and_a_second_none(toy: Any) -> None:
    first = toy.run()
    assert toy.status(first) == {
        "cut one": "done", "times one.00000": "done", "times one.00001": "done", "total one": "done",
    }  # fmt: skip
    assert toy.total("one") == 2 * (1 + 2 + 3 + 4 + 5)
    assert set(toy.status(toy.run()).values()) == {"reused"}


def test_a_parameter_reruns_its_stage_and_what_follows_only(toy: Any) -> None:
    toy.run()
    toy.factor = 3.0
    assert toy.status(toy.run()) == {
        "cut one": "reused", "times one.00000": "done", "times one.00001": "done", "total one": "done",
    }  # fmt: skip
    assert toy.total("one") == 45


def test_an_unchanged_output_stops_the_ripple(toy: Any) -> None:
    toy.run()
    toy.is_rounded = True  # doubles of whole numbers are whole already
    statuses = toy.status(toy.run())
    assert statuses["times one.00000"] == statuses["times one.00001"] == "done"
    assert statuses["total one"] == "reused"


def test_sweeps_coexist(toy: Any) -> None:
    toy.run()
    toy.factor = 3.0
    toy.run()
    toy.factor = 2.0
    assert set(toy.status(toy.run()).values()) == {"reused"}


def test_only_a_new_sequence_is_computed(toy: Any) -> None:
    toy.run()
    toy.record("two", 10, 20)
    statuses = toy.status(toy.run())
    assert {name for name, status in statuses.items() if status == "done"} == {
        "cut two",
        "times two.00000",
        "total two",
    }
    assert toy.total("two") == 60


def test_only_a_changed_file_is_computed_again(toy: Any) -> None:
    toy.record("two", 10, 20)
    toy.run()
    toy.record("two", 10, 21)
    statuses = toy.status(toy.run())
    assert {name.split()[1].split(".")[0] for name, status in statuses.items() if status == "done"} == {"two"}


def test_a_failed_shard_blocks_only_what_depends_on_it(toy: Any) -> None:
    toy.record("bad", 1, 2, 3, float("nan"), 5, 6, 7)
    found = {f"{r.node} {r.shard}": r for r in toy.run()}
    assert found["times bad.00001"].status == "failed"
    assert found["times bad.00001"].error == "frame 3 is no number"
    assert [found[f"times bad.0000{i}"].status for i in (0, 2)] == ["done", "done"]
    assert found["total bad"].status == "blocked"
    assert found["total bad"].error == "needs times"
    assert found["total one"].status == "done"


def test_a_sequence_that_cannot_be_cut_fails_alone(toy: Any) -> None:
    toy.record("bad", float("nan"))
    found = {f"{r.node} {r.shard}": r for r in toy.run()}
    assert found["cut bad"].error == "the file holds no number"
    assert found["times bad"].status == found["total bad"].status == "blocked"
    assert found["total one"].status == "done"


@pytest.mark.parametrize("damage", ["truncate", "flip", "remove", "record"])
def test_a_damaged_entry_is_found_and_made_anew(toy: Any, damage: str) -> None:
    first = {f"{r.node} {r.shard}": r for r in toy.run()}
    entry = toy.store.entry("multiply", first["times one.00001"].key)
    table = entry / "numbers.parquet"
    if damage == "truncate":
        table.write_bytes(table.read_bytes()[:-20])
    elif damage == "flip":
        content = bytearray(table.read_bytes())
        content[len(content) // 4] ^= 0xFF
        table.write_bytes(bytes(content))
    elif damage == "remove":
        table.unlink()
    else:
        (entry / "record.json").write_text('{"stage": "mul')
    shutil.rmtree(toy.store.entry("sum", first["total one"].key))
    for _ in range(2):  # a flipped byte is found when the table is read, and made anew on the next round
        again = {f"{r.node} {r.shard}": r for r in toy.run()}
    assert again["total one"].has_entry
    assert again["times one.00001"].outputs["numbers"].digest == first["times one.00001"].outputs["numbers"].digest
    assert toy.total("one") == 30
    assert list(toy.store.leftovers())


def test_no_unfinished_folder_stays_after_a_failure(toy: Any) -> None:
    toy.record("bad", 1, float("nan"))
    toy.run()
    assert list(toy.store.root.glob("*/.*")) == []
    log = (toy.workspace / "logs" / "times-bad.00000.log").read_text()
    assert "ValueError: frame 1 is no number" in log


def _cutting(toy: Any, run: Any = None) -> Task:
    """Return the task that cuts the recording, by another function if one is given."""
    work = toy.works()[0]
    (task,) = work.tasks(work.config.dag.nodes["cut"])
    stage = replace(task.node.stage, run=run or task.node.stage.run)
    return replace(task, node=replace(task.node, stage=stage))


def test_of_two_that_make_the_same_entry_both_tell_what_is_in_the_store(toy: Any) -> None:
    """The slower one found other numbers, as a CPU may beside a GPU, and keeps its own folder until its end."""
    results = []

    def cut(config: StageConfig, inputs: Tables, context: Context) -> Tables:
        with own_folder(context.scratch_dir) as own:
            results.append(run_task(_cutting(toy), {}))
            assert own.is_dir(), "removed under its hands"
        tables = _cutting(toy).node.stage.run(config, inputs, context)
        nearly = pa.compute.add(tables["numbers"]["value"], 1e-7)
        return {**tables, "numbers": tables["numbers"].set_column(2, "value", nearly)}

    results.append(run_task(_cutting(toy, cut), {}))
    first, second = results
    assert first.status == second.status == "done" and second.outputs == first.outputs
    assert toy.store.find("cut", first.key).outputs == first.outputs
    assert not list(toy.workspace.glob("scratch/*"))


@pytest.mark.parametrize("is_made", [True, False])
def test_who_fails_while_another_makes_the_entry_has_not_failed(toy: Any, is_made: bool) -> None:
    def cut(config: StageConfig, inputs: Tables, context: Context) -> Tables:
        if is_made:
            assert run_task(_cutting(toy), {}).status == "done"
        raise FileNotFoundError("last.ckpt")

    task = _cutting(toy, cut)
    result = run_task(task, {})
    assert (result.status, result.error) == (("reused", "") if is_made else ("failed", "last.ckpt"))
    assert result.has_entry == is_made
    assert ("FileNotFoundError: last.ckpt" in task.log.read_text()) != is_made


def _excess(toy: Any, name: str) -> float:
    folder = toy.workspace / "runs" / "latest" / "excess" / "numbers"
    return float(pa.parquet.read_table((folder / f"{name}.00000.parquet").resolve())["value"][0].as_py())


def test_a_node_about_all_sequences_runs_once_and_what_follows_runs_for_each(toy: Any) -> None:
    toy.targets = ("excess",)
    toy.record("two", 10, 20)
    toy.record("other", 1000)
    toy.splits = {"other": "test"}
    first = toy.status(toy.run())
    assert first["mean all-sequences"] == "done" and list(first).count("mean all-sequences") == 1
    assert {"excess one.00000", "excess one.00001", "excess two.00000", "excess other.00000"} <= set(first)
    mean = (2 * 15 + 2 * 30) / 2  # of the training sequences' totals
    assert _excess(toy, "one") == 2 - mean and _excess(toy, "other") == 2000 - mean
    assert set(toy.status(toy.run()).values()) == {"reused"}


def test_another_sequence_or_split_makes_what_is_about_all_run_again(toy: Any) -> None:
    toy.targets = ("excess",)
    toy.record("two", 10, 20)
    toy.run()
    toy.record("three", 7)
    done = {name for name, status in toy.status(toy.run()).items() if status == "done"}
    assert {"cut three", "mean all-sequences", "excess one.00000", "excess three.00000"} <= done
    assert "times one.00000" not in done
    toy.splits = {"three": "test"}
    done = {name for name, status in toy.status(toy.run()).items() if status == "done"}
    assert "mean all-sequences" in done and "total three" not in done
    toy.names = ["three", "two", "one"]
    again = toy.status(toy.run())
    assert {name for name, status in again.items() if status == "done"} == set(), "their order does not matter"


def test_a_failed_sequence_blocks_what_is_about_all(toy: Any) -> None:
    toy.targets = ("excess",)
    toy.record("bad", 1, 2, 3, float("nan"))
    found = {f"{r.node} {r.shard}": r for r in toy.run()}
    leave_out = "but bad failed: put it right, or leave it out by adding ,-bad to seq="
    assert found["total bad"].error == "needs times", "its own failure needs no name"
    assert found["mean all-sequences"].status == "blocked" and found["total one"].status == "done"
    assert found["mean all-sequences"].error == f"needs total, {leave_out}"
    assert found["excess one.00000"].error == f"needs mean, {leave_out}", "and not all sequences, though all lack it"
    assert found["excess bad.00001"].error == "needs mean, times" and found["excess bad.00000"].error == "needs mean"


def test_of_many_failed_sequences_two_are_named(toy: Any) -> None:
    toy.targets = ("excess",)
    for name in ("bad", "odd", "off"):
        toy.record(name, 1, 2, 3, float("nan"))
    found = {f"{r.node} {r.shard}": r.error for r in toy.run()}
    rest = "put them right, or leave them out by adding ,-NAME for each to seq="
    assert found["mean all-sequences"] == f"needs total, but bad, odd and 1 more failed: {rest}"


def test_a_plan_shows_what_is_about_all_and_what_waits_for_it(toy: Any) -> None:
    toy.targets = ("excess",)
    before = toy.plan()
    assert before["one", "cut"].num_to_run == 1 and before["all-sequences", "mean"].num_to_run is None
    toy.run()
    again = toy.plan()
    assert {(key[1], row.num_to_run) for key, row in again.items()} == {
        (name, 0) for name in ("cut", "times", "total", "mean", "excess")
    }
    toy.factor = 3.0
    changed = toy.plan()
    assert changed["one", "times"].num_to_run == 2 and changed["all-sequences", "mean"].num_to_run == 1
    assert changed["all-sequences", "mean"].reason == "total runs first"
    assert changed["one", "excess"].num_to_run == 2 and "runs first" in changed["one", "excess"].reason


def test_what_no_sequence_brings_is_said(toy: Any) -> None:
    toy.targets = ("mean",)
    dag = toy.config().dag
    assert "mean" in [node.name for node in dag.upto(("mean",), ("sources",))], "others may bring it"
