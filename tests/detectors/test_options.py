from assemblyhands_core.detectors.options import options_for_sequence


def test_the_sequences_name_is_filled_into_texts_alone() -> None:
    options = {
        "root": "/data/{sequence_id}/2d/{sequence_id}.parquet",
        "mode": "balanced",
        "max_persons": 2,
        "path": None,
    }
    assert options_for_sequence(options, "monday") == {
        "root": "/data/monday/2d/monday.parquet",
        "mode": "balanced",
        "max_persons": 2,
        "path": None,
    }
    assert options["root"] == "/data/{sequence_id}/2d/{sequence_id}.parquet"


def test_other_braces_stay() -> None:
    assert options_for_sequence({"pattern": "{frame:06d}"}, "monday") == {"pattern": "{frame:06d}"}
