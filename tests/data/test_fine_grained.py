"""Verb segments in both CSV forms: the released rows as examples, round trips, rows that cannot be read."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from assemblyhands_core.data import fine_grained
from assemblyhands_core.data.fine_grained import (
    PAPER_VERBS,
    VERBS,
    Action,
    Segment,
    read_fine_grained,
    verb_at,
    write_actions,
    write_fine_grained_30fps,
    write_fine_grained_60fps,
)
from assemblyhands_core.data.json_files import FormatError

RECORDING = "nusar-2021_action_both_1001-c09a_1001_user_id_2022-03-02_091830"
NOUNS = ("wheel", "bolt", "chassis")
VIEWS = ("C10095_rgb", "C10115_rgb", "HMC_84355350_mono10bit")
HEADER_60 = (
    "id,video,start_frame,end_frame,action_id,verb_id,noun_id,action_cls,verb_cls,noun_cls,toy_id,toy_name,is_shared"
)


def _segment(start: int, end: int, verb: str = "screw", noun: str = "bolt", views: tuple[str, ...] = ()) -> Segment:
    return Segment(RECORDING, start, end, 60, Action.of(verb, noun, NOUNS), "c09a", "car", True, views)


ROWS = st.lists(
    st.tuples(st.integers(0, 10**6), st.integers(0, 5000), st.sampled_from(VERBS), st.sampled_from(NOUNS)), max_size=8
)


def test_verbs_and_their_numbers() -> None:
    assert len(set(VERBS)) == len(VERBS) == 24
    assert [VERBS.index(verb) for verb in PAPER_VERBS] == [0, 5, 6, 1, 7, 4]
    action = Action.of("unscrew", "chassis", NOUNS)
    assert (action.verb_id, action.noun_id, action.action_id, action.name) == (4, 2, 14, "unscrew chassis")


def test_the_released_example_at_both_rates() -> None:
    assert (_segment(169, 223).at_rate(30).start_frame, _segment(169, 223).at_rate(30).end_frame) == (84, 111)
    back = _segment(169, 223).at_rate(30).at_rate(60)
    assert (back.start_frame, back.end_frame, back.rate_hz) == (168, 223, 60)


@given(start=st.integers(0, 10**6), length=st.integers(0, 1000))
@settings(max_examples=50, deadline=None, derandomize=True)
def test_thirty_to_sixty_and_back_is_exact(start: int, length: int) -> None:
    segment = Segment(RECORDING, start, start + length, 30, None)
    assert segment.at_rate(60).at_rate(30) == segment
    assert segment.at_rate(60).end_frame - segment.at_rate(60).start_frame + 1 == 2 * (length + 1)


@given(rows=ROWS)
@settings(max_examples=30, deadline=None, derandomize=True)
def test_the_60fps_form_round_trips(
    tmp_path_factory: pytest.TempPathFactory, rows: list[tuple[int, int, str, str]]
) -> None:
    segments = [_segment(start, start + length, verb, noun) for start, length, verb, noun in rows]
    path = tmp_path_factory.mktemp("csv") / "train.csv"
    write_fine_grained_60fps(path, segments)
    read = read_fine_grained(path)
    assert read.segments == tuple(segments) and read.malformed == ()


def test_the_30fps_form_lists_every_view_and_round_trips(tmp_path: Path) -> None:
    segments = [
        _segment(168, 223, views=VIEWS).at_rate(30),
        _segment(300, 305, "pick up", "wheel", VIEWS[:1]).at_rate(30),
    ]
    write_fine_grained_30fps(tmp_path / "a.csv", segments)
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert lines[0] == HEADER_60 + ",is_RGB"
    assert lines[1] == f"0,{RECORDING}/C10095_rgb.mp4,84,111,19,6,1,screw bolt,screw,bolt,c09a,car,1,1"
    assert lines[3].startswith(f"2,{RECORDING}/HMC_84355350_mono10bit.mp4,") and lines[3].endswith(",1,0")
    read = read_fine_grained(tmp_path / "a.csv")
    assert read.segments == tuple(segments) and read.malformed == ()


def test_the_60fps_form_pads_its_numbers(tmp_path: Path) -> None:
    write_fine_grained_60fps(tmp_path / "a.csv", [_segment(169, 223)])
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert lines[0] == HEADER_60
    assert lines[1] == f"0000000,{RECORDING},000000169,000000223,0019,0006,0001,screw bolt,screw,bolt,c09a,car,1"


def test_both_forms_say_the_same_time(tmp_path: Path) -> None:
    segment = _segment(168, 223, views=VIEWS)
    write_fine_grained_60fps(tmp_path / "60.csv", [segment])
    write_fine_grained_30fps(tmp_path / "30.csv", [segment])
    (fine,), (coarse,) = (read_fine_grained(tmp_path / name).segments for name in ("60.csv", "30.csv"))
    assert (fine.rate_hz, coarse.rate_hz) == (60, 30)
    assert (coarse.at_rate(60).start_frame, coarse.at_rate(60).end_frame) == (fine.start_frame, fine.end_frame)


def test_equal_rows_of_the_60fps_form_are_two_segments(tmp_path: Path) -> None:
    write_fine_grained_60fps(tmp_path / "a.csv", [_segment(1, 2), _segment(1, 2)])
    assert len(read_fine_grained(tmp_path / "a.csv").segments) == 2


def test_labels_may_be_withheld(tmp_path: Path) -> None:
    (tmp_path / "test.csv").write_text(
        f"id,video,start,end,is_shared,is_RGB\n0,{RECORDING}/C10095_rgb.mp4,84,111,0,1\n"
    )
    (segment,) = read_fine_grained(tmp_path / "test.csv").segments
    assert segment == Segment(RECORDING, 84, 111, 30, None, views=("C10095_rgb",))


@pytest.mark.parametrize(
    ("row", "reason"),
    [
        ("0,{r},9,5,0,6,1,a,screw,bolt,t,t,0", "ends at frame 5 before it begins at 9"),
        ("0,{r},x,5,0,6,1,a,screw,bolt,t,t,0", "start_frame is 'x'"),
        ("0,{r},-3,5,0,6,1,a,screw,bolt,t,t,0", "start_frame is '-3'"),
        ("0,{r},1.0,5,0,6,1,a,screw,bolt,t,t,0", "start_frame is '1.0'"),
        ("0,{r},1,9999999999999999,0,6,1,a,screw,bolt,t,t,0", "end_frame is '9999"),
        ("0,{r},1,5,0,5,1,a,screw,bolt,t,t,0", "'screw' does not have the number 5"),
        ("0,{r},1,5,0,99,1,a,dance,bolt,t,t,0", "'dance' does not have the number 99"),
        ("0,../../etc,1,5,0,6,1,a,screw,bolt,t,t,0", "video is '../../etc'"),
        ("0,{r}/a/b.mp4,1,5,0,6,1,a,screw,bolt,t,t,0", "instead of <recording>/<view>.mp4"),
        ("0,{r},1,5,0,6,1,a,screw,bolt,t,t,0,7,8", "more values than the file has columns"),
        ("0,{r},1,5", "verb_id is ''"),
        ("0,{r},1,5,0,6,1,a,screw,bolt,t,t,maybe", "is_shared is 'maybe'"),
    ],
)
def test_bad_rows_are_named_and_the_others_read(tmp_path: Path, row: str, reason: str) -> None:
    good = f"0,{RECORDING},1,5,0,6,1,screw bolt,screw,bolt,t,t,0"
    (tmp_path / "a.csv").write_text("\n".join([HEADER_60, good, row.format(r=RECORDING), good]) + "\n")
    read = read_fine_grained(tmp_path / "a.csv")
    assert len(read.segments) == 2
    (sentence,) = read.malformed
    assert "a.csv, line 3: " in sentence and reason in sentence and sentence.endswith("left out.")


def test_a_view_listed_twice_is_named(tmp_path: Path) -> None:
    write_fine_grained_30fps(tmp_path / "a.csv", [_segment(1, 2, views=("C1_rgb", "C1_rgb"))])
    read = read_fine_grained(tmp_path / "a.csv")
    assert read.segments[0].views == ("C1_rgb",)
    assert "line 3: view C1_rgb of this segment was listed before" in read.malformed[0]


@pytest.mark.parametrize(
    ("content", "reason"),
    [(b"", "has no column video"), (b"a,b\n1,2\n", "has no column video, start_frame, end_frame"),
     (b"\xff\xfe", "cannot be read as CSV"), (b'video,start,end\n"' + b"x" * 200_000, "cannot be read as CSV")],
)  # fmt: skip
def test_files_that_are_none(tmp_path: Path, content: bytes, reason: str) -> None:
    (tmp_path / "a.csv").write_bytes(content)
    with pytest.raises(FormatError, match=f"a.csv.*{reason}"):
        read_fine_grained(tmp_path / "a.csv")


def test_rows_are_read_one_by_one_up_to_a_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.csv"
    path.write_text("video,start_frame,end_frame\n" + "x\n" * 5)
    monkeypatch.setattr(fine_grained, "MAX_ROWS", 5)
    assert len(read_fine_grained(path).malformed) == 5
    monkeypatch.setattr(fine_grained, "MAX_ROWS", 4)
    with pytest.raises(FormatError, match="has more than 4 rows"):
        read_fine_grained(path)


def test_what_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="has no view"):
        write_fine_grained_30fps(tmp_path / "a.csv", [_segment(1, 2)])
    with pytest.raises(ValueError, match="no action to write"):
        write_fine_grained_60fps(tmp_path / "a.csv", [Segment(RECORDING, 1, 2, 60, None)])


def test_every_action_once_by_number(tmp_path: Path) -> None:
    actions = [
        Action.of(verb, noun, NOUNS) for verb, noun in (("screw", "bolt"), ("pick up", "wheel"), ("screw", "bolt"))
    ]
    write_actions(tmp_path / "actions.csv", actions)
    assert (tmp_path / "actions.csv").read_text() == (
        "id,action_id,verb_id,noun_id,action_cls,verb_cls,noun_cls\n"
        "0,0,0,0,pick up wheel,pick up,wheel\n1,19,6,1,screw bolt,screw,bolt\n"
    )


def test_the_verb_of_an_instant_is_that_of_the_latest_segment() -> None:
    pick, screw = (Action.of(verb, "wheel", ("wheel",)) for verb in ("pick up", "screw"))
    segments = [
        Segment("r", 10, 20, 30, pick).at_rate(60),
        Segment("r", 36, 50, 60, screw),
        Segment("r", 38, 39, 60, None),
    ]
    assert [verb_at(segments, key) for key in (19, 20, 35, 36, 38, 41, 50, 51)] == [
        "", "pick up", "pick up", "screw", "screw", "screw", "screw", "",
    ]  # fmt: skip
