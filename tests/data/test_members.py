from assemblyhands_core.data.catalog import MEMBERS
from assemblyhands_core.data.members import judged_of, judged_sequences


def test_networks_are_judged_by_what_is_not_for_training() -> None:
    split_of = {"a": "train", "b": "manual_train", "c": "val", "d": "manual_val", "e": "test", "f": "desktop", "g": ""}
    assert judged_sequences(split_of) == {"e", "f", "g"}
    members = MEMBERS.from_rows([{"sequence_id": name, "split": split} for name, split in reversed(split_of.items())])
    assert judged_of(members) == ["e", "f", "g"]


def test_by_all_where_there_is_nothing_else() -> None:
    assert judged_sequences({"a": "train", "b": "val"}) == {"a", "b"}
    assert judged_sequences({}) == frozenset()
