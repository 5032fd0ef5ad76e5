import shutil
from typing import Any

import pytest


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
