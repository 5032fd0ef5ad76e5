"""Which stretches of recordings show which of the chosen verbs: what verb classification learns from and is judged by.

`fine_grained` reads the labels and names the rows that it cannot read (ends before it begins, no such verb, no number).
Here the segments that are wanted are chosen from what could be read. Nothing is dropped silently: rows that were read
= segments + those dropped, each for the first reason that holds.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

import numpy as np
from jaxtyping import Float64

from assemblyhands_core.data.assemblyhands import KEY_RATE_HZ
from assemblyhands_core.data.fine_grained import PAPER_VERBS, VERBS, FineGrained, Segment

UNKNOWN_NOUN: Final = -1
"""The place of an object that is none of those a network knows."""


class Drop(StrEnum):
    """Why a segment is left out; compares equal to its string."""

    UNREADABLE = "unreadable"
    """The row says nothing that could be understood; the reader's sentence names line and reason."""
    WITHHELD_LABEL = "withheld_label"
    """The file does not say what is done, as in Assembly101's test files."""
    OTHER_VERB = "other_verb"
    OTHER_RECORDING = "other_recording"
    """Of a recording that was not asked for, or whose poses are missing."""
    BEYOND_VIDEO = "beyond_video"
    """It lies before the recording's first frame or after its last one, as a whole."""
    TOO_SHORT = "too_short"
    OVERLAP = "overlap"
    """Another segment covers more of it than allowed; only where the selection says so."""


class Note(StrEnum):
    """What is odd about a segment that is kept."""

    CUT_TO_VIDEO = "cut_to_video"
    """It began before the recording or ended after it; what lies inside is kept."""
    OVERLAPPED = "overlapped"


@dataclass(frozen=True)
class VerbSelection:
    """Which segments are chosen.

    Attributes:
        verbs: The verbs, in the order of the classes.
        min_duration_s: Shorter ones are dropped; 0 keeps everything of one frame or more.
        max_overlap: A segment of which a longer one covers a larger share is counted as overlapped; of two that are
            equally long, the later one in the file.
        is_overlap_dropped: Whether overlapped segments are dropped. Real ones overlap legitimately (two hands do
            different things), so they are kept by default.
    """

    verbs: tuple[str, ...] = PAPER_VERBS
    min_duration_s: float = 0.0
    max_overlap: float = 0.5
    is_overlap_dropped: bool = False

    def __post_init__(self) -> None:
        """Refuse verbs that nobody labels."""
        if unknown := [verb for verb in self.verbs if verb not in VERBS]:
            raise ValueError(f"{unknown[0]!r} is no verb of Assembly101; choose among {', '.join(VERBS)}.")
        if not self.verbs or len(set(self.verbs)) < len(self.verbs):
            raise ValueError(f"the verbs {self.verbs} are none, or name one twice; name each once.")


@dataclass(frozen=True)
class VerbSegment:
    """A stretch of a recording that shows one verb; frames are counted at 60 Hz and both ends belong to it.

    Attributes:
        recording: Its recording.
        number: Its place among the chosen ones of its recording, by first frame and then as in the file. Recording and
            number identify a segment: two hands may begin the same at the same frame.
        verb: One of those chosen.
        noun: With what.
        first_key: First 60 Hz frame.
        last_key: Last 60 Hz frame, which belongs to it.
        overlap: Largest share of it that a single longer segment of the recording covers, whatever that one's verb.
    """

    recording: str
    number: int
    verb: str
    noun: str
    first_key: int
    last_key: int
    overlap: float = 0.0

    @property
    def start_s(self) -> float:
        """When it begins; key 0 is at 0 s."""
        return self.first_key / KEY_RATE_HZ

    @property
    def end_s(self) -> float:
        """When its last frame ends."""
        return (self.last_key + 1) / KEY_RATE_HZ


@dataclass(frozen=True)
class VerbSegments:
    """What was chosen, and what was not.

    Attributes:
        segments: By recording and time.
        dropped: How many were left out, by reason.
        noted: How many of those kept are odd, by what is odd.
        problems: One sentence for each row that is malformed or odd: unreadable, beyond the video, cut to it, too
            short, overlapped. What is said of a segment begins with its recording, of a row with the file.
    """

    segments: tuple[VerbSegment, ...]
    dropped: Mapping[Drop, int]
    noted: Mapping[Note, int]
    problems: tuple[str, ...]


def select_verb_segments(found: FineGrained, selection: VerbSelection, video_keys: Mapping[str, range]) -> VerbSegments:
    """Choose the segments of some recordings.

    Args:
        found: What a file of fine-grained labels holds, in either form.
        selection: Which are chosen.
        video_keys: The recordings that are asked for, with the 60 Hz frames that each one's videos or poses have.
    """
    wanted: dict[str, list[Segment]] = {}
    for segment in found.segments:
        if segment.recording in video_keys:
            wanted.setdefault(segment.recording, []).append(segment.at_rate(KEY_RATE_HZ))
    chosen: list[VerbSegment] = []
    verdicts: list[_Verdict] = []
    for recording, segments in sorted(wanted.items()):
        of_recording = _judged(segments, video_keys[recording], selection)
        kept = sorted((v.segment for v in of_recording if not v.drop), key=lambda segment: segment.first_key)
        chosen += [replace(segment, number=number) for number, segment in enumerate(kept)]
        verdicts += of_recording
    dropped = Counter(verdict.drop for verdict in verdicts if verdict.drop)
    dropped[Drop.UNREADABLE] += len(found.malformed)
    dropped[Drop.OTHER_RECORDING] += len(found.segments) - len(verdicts)
    noted = Counter(note for verdict in verdicts if not verdict.drop for note in verdict.notes)
    sentences = [sentence for verdict in verdicts for sentence in verdict.sentences(video_keys)]
    return VerbSegments(tuple(chosen), dict(+dropped), dict(noted), (*found.malformed, *sentences))


@dataclass(frozen=True)
class _Verdict:
    """What becomes of one segment; cut to the video where some of it lies there."""

    segment: VerbSegment
    drop: Drop | None = None
    notes: tuple[Note, ...] = ()

    def sentences(self, video_keys: Mapping[str, range]) -> list[str]:
        """Return what is wrong with the segment; other verbs and withheld labels are not wrong."""
        one, keys = self.segment, video_keys[self.segment.recording]
        video = f"the recording's frames {keys.start} to {keys.stop - 1}"
        said = {
            Drop.BEYOND_VIDEO: f"lies outside {video}; it is left out",
            Drop.TOO_SHORT: "is shorter than asked for; it is left out",
            Drop.OVERLAP: f"is covered by another one to {one.overlap:.0%}; it is left out",
            Note.CUT_TO_VIDEO: f"is what lies in {video}; the rest is cut off",
            Note.OVERLAPPED: f"is covered by another one to {one.overlap:.0%}; it is kept",
        }
        reasons = [self.drop] if self.drop else list(self.notes)
        name = f"{one.recording}: {one.verb!r} at 60 Hz frames {one.first_key} to {one.last_key}"
        return [f"{name} {said[reason]}." for reason in reasons if reason in said]


def _judged(segments: Sequence[Segment], keys: range, selection: VerbSelection) -> list[_Verdict]:
    labelled = [(segment, segment.action) for segment in segments if segment.action is not None]
    shares = _overlaps([segment for segment, _ in labelled], keys)
    found = [
        VerbSegment(one.recording, -1, action.verb, action.noun, one.start_frame, one.end_frame, float(share))
        for (one, action), share in zip(labelled, shares, strict=True)
    ]
    unlabelled = [VerbSegment(s.recording, -1, "", "", s.start_frame, s.end_frame) for s in segments if not s.action]
    withheld = [_Verdict(segment, Drop.WITHHELD_LABEL) for segment in unlabelled]
    return [_judge(segment, keys, selection) for segment in found] + withheld


def _judge(segment: VerbSegment, keys: range, selection: VerbSelection) -> _Verdict:
    if segment.verb not in selection.verbs:
        return _Verdict(segment, Drop.OTHER_VERB)
    first, last = max(segment.first_key, keys.start), min(segment.last_key, keys.stop - 1)
    if first > last:
        return _Verdict(segment, Drop.BEYOND_VIDEO)
    if (last - first + 1) / KEY_RATE_HZ < selection.min_duration_s:
        return _Verdict(segment, Drop.TOO_SHORT)
    is_overlapped = segment.overlap > selection.max_overlap
    if is_overlapped and selection.is_overlap_dropped:
        return _Verdict(segment, Drop.OVERLAP)
    is_cut = (first, last) != (segment.first_key, segment.last_key)
    notes = (Note.CUT_TO_VIDEO,) * is_cut + (Note.OVERLAPPED,) * is_overlapped
    return _Verdict(replace(segment, first_key=first, last_key=last), notes=notes)


def _overlaps(segments: Sequence[Segment], keys: range) -> Float64[np.ndarray, " segment"]:
    """Return the largest share of each segment that a longer one covers, of what lies in the video.

    Of two segments that are as long, the earlier in the file counts as the longer one.
    """
    if not segments:
        return np.zeros(0)
    first, last = np.clip([(s.start_frame, s.end_frame + 1) for s in segments], keys.start, keys.stop).T
    length, place = last - first, np.arange(len(segments))
    common = np.minimum(last[:, None], last) - np.maximum(first[:, None], first)
    is_longer = (length > length[:, None]) | ((length == length[:, None]) & (place < place[:, None]))
    covered = np.where(is_longer, np.maximum(common, 0), 0).max(axis=1)
    return np.asarray(covered / np.maximum(length, 1))
