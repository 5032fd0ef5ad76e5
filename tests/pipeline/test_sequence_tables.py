from pathlib import Path

from finished_run import write_rounds

from assemblyhands_core.data.catalog import JOINTS
from pipeline.sequence_tables import SequenceTables, between, sequence_of


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
