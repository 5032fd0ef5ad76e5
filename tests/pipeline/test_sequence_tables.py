from pathlib import Path

import pytest
from finished_run import write_rounds

from assemblyhands_core.data.catalog import JOINTS
from pipeline.config import UserError
from pipeline.sequence_tables import SequenceTables, between, chosen_sequences, sequence_of


def test_a_sequence_has_its_own_rows_of_all_chunks_alone(tmp_path: Path) -> None:
    for sequence_id in ("monday", "monday.evening"):
        for chunk in (0, 1):
            write_rounds(tmp_path, sequence_id, chunk, [[0.0, 1.0], [0.0, 2.0]])
    tables = SequenceTables(tmp_path, "monday")
    joints = tables.read("round_1", "joints", JOINTS)
    assert joints["frame"].to_pylist() == [0, 1, 10, 11] and set(joints["sequence_id"].to_pylist()) == {"monday"}
    assert tables.nodes_with("joints") == ["round_0", "round_1"] and tables.nodes_with("crops") == ["crop_hands"]
    assert SequenceTables(tmp_path, "tuesday").nodes_with("joints") == []
    assert between(joints, 1, 11)["frame"].to_pylist() == [1, 10]


def test_what_the_run_does_not_have_is_a_table_without_rows(tmp_path: Path) -> None:
    assert SequenceTables(tmp_path, "monday").read("round_7", "joints", JOINTS).equals(JOINTS.empty())


def test_names_may_end_like_shards_and_sequences() -> None:
    assert sequence_of(Path("monday.00012.parquet")) == "monday"
    assert sequence_of(Path("monday.parquet")) == "monday"
    assert sequence_of(Path("mon.day.2.parquet")) == "mon.day.2"


@pytest.mark.parametrize(
    ("wanted", "chosen"),
    [
        ("all", ["friday", "monday", "tuesday"]),
        ("monday", ["monday"]),
        ("tuesday, f*", ["friday", "tuesday"]),
        ("*s*,sunday", ["tuesday"]),
        ("all,-monday", ["friday", "tuesday"]),
        ("-*s*,-sunday", ["friday", "monday"]),
    ],
)
def test_sequences_are_chosen_by_names_and_globs(wanted: str, chosen: list[str]) -> None:
    assert chosen_sequences(wanted, ["friday", "monday", "tuesday"], "mine", "joints") == chosen


@pytest.mark.parametrize(
    ("wanted", "there", "names"),
    [("Monday", ["monday", "b"], "monday, b"), ("monday", [], "none"), ("all", [], "none"), ("b,-b", ["b"], "b")],
)
def test_no_sequence_to_choose_is_a_sentence(wanted: str, there: list[str], names: str) -> None:
    with pytest.raises(UserError, match=f"^run mine has no joints of sequence {wanted}; seq= is one of {names}$"):
        chosen_sequences(wanted, there, "mine", "joints")
