"""Which segments are chosen: every row of the file is a segment or counted under a reason."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from assemblyhands_core.data.fine_grained import VERBS, Action, FineGrained, Segment, read_fine_grained
from assemblyhands_core.data.verb_segments import Drop, Note, VerbSegment, VerbSelection, select_verb_segments

FIRST = "nusar-2021_action_both_1001-c09a_1001_user_id_2022-03-02_091830"
SECOND = "nusar-2021_action_both_1002-c09a_1002_user_id_2022-03-03_091830"
NOUNS = ("wheel", "bolt")
HEADER = (
    "id,video,start_frame,end_frame,action_id,verb_id,noun_id,action_cls,verb_cls,noun_cls,toy_id,toy_name,is_shared"
)
SIX = VerbSelection()


def _segment(start: int, end: int, verb: str = "screw", recording: str = FIRST) -> Segment:
    return Segment(recording, start, end, 60, Action.of(verb, "bolt", NOUNS))


def _found(*segments: Segment) -> FineGrained:
    return FineGrained(segments, ())


def test_a_file_with_every_fault(tmp_path: Path) -> None:
    rows = [
        f"0000000,{FIRST},000000120,000000239,0013,0006,0001,screw bolt,screw,bolt,c09a,car,0",
        f"0000001,{FIRST},000000060,000000089,0013,0000,0001,pick up bolt,pick up,bolt,c09a,car,0",
        f"0000002,{FIRST},000000300,000000280,0013,0006,0001,screw bolt,screw,bolt,c09a,car,0",  # ends before it begins
        f"0000003,{FIRST},000000300,000000320,0013,0099,0001,dance bolt,dance,bolt,c09a,car,0",  # no such verb
        f"0000004,{FIRST},000000600,000000700,0013,0006,0001,screw bolt,screw,bolt,c09a,car,0",  # beyond the video
        f"0000005,{FIRST},000000580,000000619,0013,0001,0001,put down bolt,put down,bolt,c09a,car,0",  # partly
        f"0000006,{FIRST},000000180,000000209,0013,0005,0001,position bolt,position,bolt,c09a,car,0",  # inside another
        f"0000007,{FIRST},000000400,000000401,0013,0007,0001,remove bolt,remove,bolt,c09a,car,0",  # too short
        f"0000008,{FIRST},000000410,000000440,0013,0002,0001,inspect bolt,inspect,bolt,c09a,car,0",  # another verb
        f"0000009,{SECOND},000000410,000000440,0013,0006,0001,screw bolt,screw,bolt,c09a,car,0",  # without poses
    ]
    path = tmp_path / "train.csv"
    path.write_text("\n".join([HEADER, *rows]) + "\n")
    chosen = select_verb_segments(read_fine_grained(path), VerbSelection(min_duration_s=0.1), {FIRST: range(600)})
    assert chosen.segments == (
        VerbSegment(FIRST, 0, "pick up", "bolt", 60, 89),
        VerbSegment(FIRST, 1, "screw", "bolt", 120, 239),
        VerbSegment(FIRST, 2, "position", "bolt", 180, 209, overlap=1.0),
        VerbSegment(FIRST, 3, "put down", "bolt", 580, 599),
    )
    assert chosen.dropped == {
        "unreadable": 2,
        "beyond_video": 1,
        "too_short": 1,
        "other_verb": 1,
        "other_recording": 1,
    }
    assert chosen.noted == {Note.OVERLAPPED: 1, Note.CUT_TO_VIDEO: 1}
    expected = [
        "line 4: it ends at frame 280 before it begins at 300; the row is left out.",
        "line 5: its verb 'dance' does not have the number 99; the row is left out.",
        "'screw' at 60 Hz frames 600 to 700 lies outside the recording's frames 0 to 599; it is left out.",
        "'put down' at 60 Hz frames 580 to 599 is what lies in the recording's frames 0 to 599; the rest is cut off.",
        "'position' at 60 Hz frames 180 to 209 is covered by another one to 100%; it is kept.",
        "'remove' at 60 Hz frames 400 to 401 is shorter than asked for; it is left out.",
    ]
    assert len(chosen.problems) == len(expected)
    assert all(part in sentence for part, sentence in zip(expected, chosen.problems, strict=True))


def test_both_ends_belong_to_a_segment() -> None:
    (one,) = select_verb_segments(_found(_segment(60, 119)), SIX, {FIRST: range(600)}).segments
    assert (one.start_s, one.end_s) == (1.0, 2.0)
    exact = VerbSelection(min_duration_s=1.0)
    assert len(select_verb_segments(_found(_segment(60, 119)), exact, {FIRST: range(600)}).segments) == 1
    assert select_verb_segments(_found(_segment(60, 118)), exact, {FIRST: range(600)}).dropped == {Drop.TOO_SHORT: 1}


def test_frames_of_thirty_hz_are_counted_at_sixty() -> None:
    segment = Segment(FIRST, 10, 11, 30, Action.of("unscrew", "bolt", NOUNS), views=("C1_rgb",))
    (one,) = select_verb_segments(_found(segment), SIX, {FIRST: range(24)}).segments
    assert (one.first_key, one.last_key, one.verb) == (20, 23, "unscrew")


def test_a_recording_may_begin_late() -> None:
    chosen = select_verb_segments(_found(_segment(0, 9), _segment(90, 110)), SIX, {FIRST: range(100, 600)})
    assert chosen.dropped == {Drop.BEYOND_VIDEO: 1} and chosen.noted == {Note.CUT_TO_VIDEO: 1}
    assert (chosen.segments[0].first_key, chosen.segments[0].last_key) == (100, 110)


def test_withheld_labels_are_counted_and_do_not_cover() -> None:
    withheld = Segment(FIRST, 0, 100, 60, None)
    chosen = select_verb_segments(_found(withheld, _segment(10, 20)), SIX, {FIRST: range(600)})
    assert chosen.dropped == {Drop.WITHHELD_LABEL: 1} and chosen.noted == {} and chosen.problems == ()


@pytest.mark.parametrize(
    ("others", "overlap"),
    [
        ([(0, 9)], 0.0),
        ([(0, 14)], 0.5),  # longer, covers 10 to 14 of 10 to 19
        ([(0, 15), (17, 40)], 0.6),  # the larger share of a single one, not of both together
        ([(10, 12)], 0.0),  # the shorter one is covered, not this one
    ],
)
def test_the_overlap_is_the_share_that_one_longer_segment_covers(others: list[tuple[int, int]], overlap: float) -> None:
    segments = [*(_segment(*ends, verb="inspect") for ends in others), _segment(10, 19)]
    chosen = select_verb_segments(_found(*segments), SIX, {FIRST: range(600)})
    assert chosen.segments[0].overlap == overlap
    assert chosen.noted == ({Note.OVERLAPPED: 1} if overlap > 0.5 else {})  # half is not more than half


def test_of_two_equal_segments_the_later_is_dropped_by_choice() -> None:
    found = _found(_segment(10, 19), _segment(10, 19, "position"))
    kept = select_verb_segments(found, SIX, {FIRST: range(600)})
    assert [(s.verb, s.number, s.overlap) for s in kept.segments] == [("screw", 0, 0.0), ("position", 1, 1.0)]
    dropped = select_verb_segments(found, VerbSelection(is_overlap_dropped=True), {FIRST: range(600)})
    assert [s.verb for s in dropped.segments] == ["screw"] and dropped.dropped == {Drop.OVERLAP: 1}
    assert (
        "'position' at 60 Hz frames 10 to 19 is covered by another one to 100%; it is left out" in dropped.problems[0]
    )


ROWS = st.lists(
    st.tuples(
        st.sampled_from([FIRST, SECOND]), st.integers(0, 200), st.integers(0, 60), st.sampled_from([*VERBS[:8], ""])
    ),
    max_size=12,
)


@given(rows=ROWS, is_overlap_dropped=st.booleans())
@settings(max_examples=60, deadline=None, derandomize=True)
def test_rows_in_are_segments_and_counted_reasons(
    rows: list[tuple[str, int, int, str]], is_overlap_dropped: bool
) -> None:
    segments = [
        Segment(recording, start, start + length, 60, Action.of(verb, "bolt", NOUNS) if verb else None)
        for recording, start, length, verb in rows
    ]
    selection = VerbSelection(min_duration_s=0.2, is_overlap_dropped=is_overlap_dropped)
    chosen = select_verb_segments(FineGrained(tuple(segments), ("a", "b")), selection, {FIRST: range(5, 150)})
    assert len(chosen.segments) + sum(chosen.dropped.values()) == len(segments) + 2
    assert [s.number for s in chosen.segments] == list(range(len(chosen.segments)))
    assert all(5 <= s.first_key <= s.last_key < 150 and 0 <= s.overlap <= 1 for s in chosen.segments)


@pytest.mark.parametrize(
    ("verbs", "reason"), [(("dance",), "'dance' is no verb"), ((), "none"), (("screw", "screw"), "twice")]
)
def test_verbs_that_cannot_be_chosen(verbs: tuple[str, ...], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        VerbSelection(verbs=verbs)
