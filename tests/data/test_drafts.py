"""What is written beside its place is there whole or not at all."""

from pathlib import Path

import pytest

from assemblyhands_core.data.drafts import draft_beside, replaced_whole


def test_a_draft_takes_the_place_of_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "new folder" / "joints.csv"
    for text in ("old", "new"):
        with replaced_whole(path) as draft:
            draft.write_text(text)
            assert draft.parent == path.parent and draft.name.startswith(".joints.csv-")
            assert path.exists() == (text == "new")
        assert path.read_text() == text
    assert list(path.parent.iterdir()) == [path]


def test_a_draft_that_fails_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "joints.csv"
    path.write_text("old")
    with pytest.raises(ZeroDivisionError), replaced_whole(path) as draft:
        draft.write_text("half")
        raise ZeroDivisionError
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]


def test_a_link_is_replaced_and_not_what_it_leads_to(tmp_path: Path) -> None:
    (tmp_path / "run-1").mkdir()
    (tmp_path / "run-2").mkdir()
    for run in ("run-1", "run-2"):
        with replaced_whole(tmp_path / "latest") as draft:
            draft.symlink_to(run)
    assert (tmp_path / "latest").readlink() == Path("run-2")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["latest", "run-1", "run-2"]


def test_no_two_drafts_have_a_name(tmp_path: Path) -> None:
    assert len({draft_beside(tmp_path / "joints.csv") for _ in range(100)}) == 100
