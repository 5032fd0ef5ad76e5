"""Assembly101's fine-grained action labels in both of their CSV forms (formats 3.2-3.4).

The official form counts frames at 30 fps and has one row for every view of a segment; the form that comes with the
poses counts at 60 fps, pads its numbers with zeros and has one row for each segment. In both, the last frame of a
segment belongs to it. A row that cannot be read is counted and named, and never ends the reading.
"""

import csv
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal, cast

from assemblyhands_core.data.csv_files import opened_csv
from assemblyhands_core.data.json_files import FormatError
from assemblyhands_core.data.names import checked_component, checked_relative_path

RateHz = Literal[30, 60]

VERBS: Final = (
    *("pick up", "put down", "inspect", "rotate", "unscrew", "position", "screw", "remove", "position screw on"),
    *("remove screw from", "pass", "tilt up", "attempt to position", "push", "tilt down", "pull", "attempt to remove"),
    *("attempt to pick up", "clap", "attempt to unscrew", "attempt to put down", "spin", "attempt to screw", "shake"),
)
"""Assembly101's verbs; the index is `verb_id`."""

PAPER_VERBS: Final = ("pick up", "position", "screw", "put down", "remove", "unscrew")
"""The six verbs that the paper classifies."""

MAX_CSV_BYTES: Final = 2**28
MAX_ROWS: Final = 2**21
"""Twice as many as the whole data set has, which lists each of 83 thousand segments once for each of twelve views."""
_SURPLUS: Final = "values beyond the last column"
_LABELS: Final = ("action_id", "verb_id", "noun_id", "action_cls", "verb_cls", "noun_cls")
_COLUMNS_60: Final = ("id", "video", "start_frame", "end_frame", *_LABELS, "toy_id", "toy_name", "is_shared")
_COLUMNS_30: Final = (*_COLUMNS_60, "is_RGB")
_NUMBER: Final = re.compile(r"\d{1,12}", re.ASCII)
_TRUTH: Final = {"0": False, "1": True, "false": False, "true": True}


@dataclass(frozen=True)
class Action:
    """What is done with what: verb and noun with the numbers that the data set gives them."""

    verb: str
    noun: str
    verb_id: int
    noun_id: int
    action_id: int
    name: str

    @staticmethod
    def of(verb: str, noun: str, nouns: Sequence[str]) -> "Action":
        """Return the action of a data set of one's own; actions are numbered by verb, then noun.

        Args:
            verb: One of `VERBS`.
            noun: One of `nouns`.
            nouns: All nouns of the data set.

        Raises:
            ValueError: Verb or noun are none of these.
        """
        verb_id, noun_id = VERBS.index(verb), list(nouns).index(noun)
        return Action(verb, noun, verb_id, noun_id, verb_id * len(nouns) + noun_id, f"{verb} {noun}")


@dataclass(frozen=True)
class Segment:
    """A stretch of a recording in which one action is done.

    Attributes:
        recording: Its recording.
        start_frame: First frame.
        end_frame: Last frame, which belongs to it.
        rate_hz: What frames count.
        action: What is done; None in test files, whose labels are withheld.
        toy_id: The toy, as in the recording's name.
        toy_name: The toy in words.
        is_shared: Whether the toy also occurs in other splits.
        views: The views that a file lists for it; none in the 60 fps form, which means all.
    """

    recording: str
    start_frame: int
    end_frame: int
    rate_hz: RateHz
    action: Action | None
    toy_id: str = ""
    toy_name: str = ""
    is_shared: bool = False
    views: tuple[str, ...] = ()

    def at_rate(self, rate_hz: RateHz) -> "Segment":
        """Return the segment counted at another rate: frame n of 30 fps is the frames 2 n and 2 n + 1 of 60 fps."""
        if rate_hz == self.rate_hz:
            return self
        start, end = (
            (self.start_frame // 2, self.end_frame // 2)
            if rate_hz == 30
            else (2 * self.start_frame, 2 * self.end_frame + 1)
        )
        return replace(self, start_frame=start, end_frame=end, rate_hz=rate_hz)


@dataclass(frozen=True)
class FineGrained:
    """What a file of fine-grained labels holds.

    Attributes:
        segments: In the order of the file.
        malformed: One sentence with the line's number for every row that could not be read.
    """

    segments: tuple[Segment, ...]
    malformed: tuple[str, ...]


def write_fine_grained_30fps(path: Path, segments: Iterable[Segment]) -> None:
    """Write the official form: 30 fps, one row for each of a segment's views, which have to be given.

    Raises:
        ValueError: A segment has no view or no action.
    """
    rows = [(segment.at_rate(30), view) for segment in segments for view in _views_of(segment)]
    blocks = [
        {**_block(segment), "id": number, "video": f"{segment.recording}/{view}.mp4", "is_RGB": int(_is_rgb(view))}
        for number, (segment, view) in enumerate(rows)
    ]
    _write(path, _COLUMNS_30, blocks)


def write_fine_grained_60fps(path: Path, segments: Iterable[Segment]) -> None:
    """Write the form of the pose data: 60 fps, one row for each segment, numbers padded with zeros.

    Raises:
        ValueError: A segment has no action.
    """
    blocks = []
    for number, segment in enumerate(segment.at_rate(60) for segment in segments):
        block = _block(segment) | {"id": f"{number:07d}", "video": segment.recording}
        frames = {name: f"{block[name]:09d}" for name in ("start_frame", "end_frame")}
        ids = {name: f"{block[name]:04d}" for name in ("action_id", "verb_id", "noun_id")}
        blocks.append({**block, **frames, **ids})
    _write(path, _COLUMNS_60, blocks)


def write_actions(path: Path, actions: Iterable[Action]) -> None:
    """Write `actions.csv`: every action once, by its number."""
    blocks = [
        {"id": number, **_labels(action)}
        for number, action in enumerate(sorted(set(actions), key=lambda action: action.action_id))
    ]
    _write(path, ("id", *_LABELS), blocks)


def read_fine_grained(path: Path) -> FineGrained:
    """Read a file of either form, recognised by what its videos are called; rows of one segment become one.

    Raises:
        FormatError: The file is missing, too large, no CSV or lacks a column.
    """
    segments: dict[tuple[object, ...], Segment] = {}
    malformed: list[str] = []
    for line, row in _rows(path):
        try:
            segment = _segment(row)
            # Rows of the same segment differ in their view alone; without views, equal rows are two segments.
            key = (replace(segment, views=()), "" if segment.views else line)
            earlier = segments.get(key)
            if earlier and segment.views[0] in earlier.views:
                raise ValueError(f"view {segment.views[0]} of this segment was listed before")
            segments[key] = replace(segment, views=(earlier.views if earlier else ()) + segment.views)
        except ValueError as error:
            malformed.append(f"{path}, line {line}: {str(error).removesuffix('.')}; the row is left out.")
    return FineGrained(tuple(segments.values()), tuple(malformed))


def verb_at(segments: Iterable[Segment], key_60hz: int) -> str:
    """Return the verb of the segment, counted at 60 Hz, that covers an instant and began last; empty if none does."""
    covering = [s for s in segments if s.start_frame <= key_60hz <= s.end_frame and s.action]
    latest = max(covering, key=lambda segment: segment.start_frame, default=None)
    return latest.action.verb if latest is not None and latest.action is not None else ""


def _views_of(segment: Segment) -> tuple[str, ...]:
    if not segment.views:
        raise ValueError(f"{segment.recording}: a segment has no view; the 30 fps form lists every view of it.")
    return segment.views


def _is_rgb(view: str) -> bool:
    return view.endswith("_rgb")


def _labels(action: Action) -> dict[str, object]:
    values = (action.action_id, action.verb_id, action.noun_id, action.name, action.verb, action.noun)
    return dict(zip(_LABELS, values, strict=True))


def _block(segment: Segment) -> dict[str, object]:
    if segment.action is None:
        raise ValueError(f"{segment.recording}: the segment at frame {segment.start_frame} has no action to write.")
    return {
        "start_frame": segment.start_frame,
        "end_frame": segment.end_frame,
        **_labels(segment.action),
        "toy_id": segment.toy_id,
        "toy_name": segment.toy_name,
        "is_shared": int(segment.is_shared),
    }


def _write(path: Path, columns: Sequence[str], blocks: Iterable[Mapping[str, object]]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(blocks)


def _rows(path: Path) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield the rows of a CSV file with the numbers of their lines; too short or long ones have odd values."""
    with opened_csv(path, MAX_CSV_BYTES, restkey=_SURPLUS, restval="") as reader:
        columns = {"start": "start_frame", "end": "end_frame"}  # as files without labels call them
        reader.fieldnames = [columns.get(name, name) for name in reader.fieldnames or ()]
        if missing := [name for name in ("video", "start_frame", "end_frame") if name not in reader.fieldnames]:
            raise FormatError(f"{path}: has no column {', '.join(missing)}; this is no file of fine-grained labels.")
        for number, row in enumerate(reader):
            if number == MAX_ROWS:
                raise FormatError(f"{path}: has more than {MAX_ROWS} rows, which no data set of this kind has.")
            yield reader.line_num, cast(dict[str, str], row)


def _segment(row: Mapping[str, str]) -> Segment:
    if _SURPLUS in row:
        raise ValueError("it has more values than the file has columns")
    recording, view = _video(row["video"])
    start, end = _number(row, "start_frame"), _number(row, "end_frame")
    if start > end:
        raise ValueError(f"it ends at frame {end} before it begins at {start}")
    return Segment(
        recording=recording,
        start_frame=start,
        end_frame=end,
        rate_hz=30 if view else 60,
        action=_action(row) if "verb_cls" in row else None,
        toy_id=row.get("toy_id", ""),
        toy_name=row.get("toy_name", ""),
        is_shared=_flag(row, "is_shared"),
        views=(view,) if view else (),
    )


def _video(value: str) -> tuple[str, str]:
    """Return recording and view, "" where the file speaks of whole recordings."""
    if "/" not in value:
        return checked_component(value, "its video"), ""
    recording, *rest = checked_relative_path(value, "its video").split("/")
    if len(rest) != 1 or not rest[0].endswith(".mp4"):
        raise ValueError(f"its video is {value!r} instead of <recording>/<view>.mp4")
    return recording, rest[0].removesuffix(".mp4")


def _action(row: Mapping[str, str]) -> Action:
    verb, verb_id = row["verb_cls"], _number(row, "verb_id")
    if verb_id >= len(VERBS) or VERBS[verb_id] != verb:
        raise ValueError(f"its verb {verb!r} does not have the number {verb_id}")
    ids = {"noun_id": _number(row, "noun_id"), "action_id": _number(row, "action_id")}
    return Action(verb=verb, noun=row.get("noun_cls", ""), verb_id=verb_id, name=row.get("action_cls", ""), **ids)


def _number(row: Mapping[str, str], column: str) -> int:
    text = row.get(column, "").strip()
    if not _NUMBER.fullmatch(text):
        raise ValueError(f"its {column} is {text[:40]!r} instead of a whole number")
    return int(text)


def _flag(row: Mapping[str, str], column: str) -> bool:
    text = row.get(column, "0").strip().lower().lstrip("0") or "0"
    if text not in _TRUTH:
        raise ValueError(f"its {column} is {text[:40]!r} instead of 0 or 1")
    return _TRUTH[text]
