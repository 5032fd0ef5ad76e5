"""Hands to look at: the worst ones and some at random, from round to round; and what nodes drew."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, islice, zip_longest
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.hand_crops import HandKey
from assemblyhands_core.viz.figures import method_label
from assemblyhands_core.viz.round_sheet import HandCourse, draw_strip
from pipeline.finished import FinishedRun
from pipeline.html_report.page import Block, Picture, Text
from pipeline.html_report.pictures import from_file, from_image
from pipeline.html_report.whole_pictures import whole_pictures
from pipeline.measured import NothingToShow
from pipeline.round_crops import HAND_KEY, follow_hands, round_label, round_nodes
from pipeline.summary import drawn_pictures

NUM_HANDS: Final = 4
"""Of the worst, and as many at random."""
MAX_DRAWN: Final = 6
"""Pictures that nodes drew, at most."""
_NUM_TRIED: Final = 3 * NUM_HANDS  # some have no stored crop
_TILE_PX: Final = 260
_SEED: Final = 0


class _Rated(NamedTuple):
    """A hand and how bad it is in each method or round; NaN where it has no joints."""

    key: HandKey
    by_method: Mapping[str, float]

    @property
    def last(self) -> float:
        return list(self.by_method.values())[-1]


def instants(run: FinishedRun) -> Iterator[Block]:
    """Yield strips of the worst hands, by error or else by reprojection, and of random ones."""
    is_judged = bool(run.measured.rounds)
    unit = "mm from the truth" if is_judged else "px from its 2D keypoints"
    rated = list(_by_error(run) if is_judged else _by_reprojection(run))
    if not rated:
        raise NothingToShow("this run has no rounds.")
    known = [hand for hand in rated if np.isfinite(hand.last)]
    worst = list(islice(_apart(sorted(known, key=lambda hand: -hand.last), run.settings.block_frames), _NUM_TRIED))
    chosen = np.random.default_rng(_SEED).permutation(len(rated))[:_NUM_TRIED]
    yield Text(
        "Each strip: the hand's stored crop in the view that shows it best, then what each round found there; the "
        "square is the window it looked through. Below it, what the last round found in the whole picture, and in the "
        "headset's where there is one. Right hands: solid lines and discs; left ones: dashed lines and squares."
    )
    yield from _strips(run, "Worst", worst, unit)
    yield from _strips(run, "Random", [rated[index] for index in chosen], unit)


def drawn(run: FinishedRun) -> Iterator[Block]:
    """Yield the pictures that the run's nodes drew: overlays of the fixed cameras, the headset's crops.

    Nodes take turns, so that one that drew many does not leave out the others.
    """
    by_node = drawn_pictures(run.folder)
    turns = zip_longest(*([(node, path) for path in paths] for node, paths in by_node.items()))
    found = ((turn[0], from_file(turn[1])) for turn in chain.from_iterable(turns) if turn is not None)
    shown = list(islice(((node, picture) for node, picture in found if picture is not None), MAX_DRAWN))
    if not shown:
        raise NothingToShow("this run drew none: `annotate` and `predict` do.")
    yield from (picture for _, picture in shown)
    num_shown = Counter(node for node, _ in shown)
    for node, paths in by_node.items():
        if num_more := len(paths) - num_shown[node]:
            where = f"they lie where the links `{node}/overlays/*.parquet` lead"
            yield Text(f"{node}: {num_more} more of {len(paths)} pictures and films; {where}.")


def _by_error(run: FinishedRun) -> Iterator[_Rated]:
    """Yield every hand's mean error by round."""
    for pool in run.measured.pools:
        for errors in pool.errors:
            by_method = {name: errors.filter(pa.compute.equal(errors["method"], name)) for name in run.measured.rounds}
            tables = {name: table for name, table in by_method.items() if table.num_rows}
            values = {name: _means(to_numpy(table["error_mm"])) for name, table in tables.items()}
            yield from _rated(next(iter(tables.values()), errors.slice(0, 0)), values)


def _by_reprojection(run: FinishedRun) -> Iterator[_Rated]:
    nodes = round_nodes(run.folder)[-1:]
    for node in nodes:
        for path in sorted((node / "joints").glob("*.parquet")):
            joints = pq.read_table(path.resolve(), columns=[*HAND_KEY, "reprojection_px"])
            yield from _rated(joints, {round_label(node): _means(to_numpy(joints["reprojection_px"]))})


def _rated(table: pa.Table, values: Mapping[str, np.ndarray]) -> Iterator[_Rated]:
    keys = zip(*(table[name].to_pylist() for name in HAND_KEY), strict=True)
    for row, key in enumerate(keys):
        yield _Rated(key, {name: float(of_name[row]) for name, of_name in values.items()})


def _means(values: np.ndarray) -> np.ndarray:
    """Return the mean of each row's known values, NaN where there are none."""
    is_known = np.isfinite(values)
    count = is_known.sum(axis=1)
    return np.where(count > 0, np.where(is_known, values, 0.0).sum(axis=1) / np.maximum(count, 1), np.nan)


def _apart(hands: Sequence[_Rated], min_frames: int) -> Iterator[_Rated]:
    """Yield those hands that are not in the same stretch of a sequence as one before."""
    taken: list[HandKey] = []
    for hand in hands:
        sequence, frame, side = hand.key
        if not any((s, h) == (sequence, side) and abs(frame - f) < min_frames for s, f, h in taken):
            taken.append(hand.key)
            yield hand


def _strips(run: FinishedRun, kind: str, hands: Sequence[_Rated], unit: str) -> Iterator[Block]:
    rated = {hand.key: hand for hand in hands}
    courses = follow_hands(run.folder, run.round_settings.window_rule(), list(rated))
    for course in courses[:NUM_HANDS]:
        yield _strip(kind, course, rated[course.key], unit)
        if (whole := whole_pictures(run, course.key, course.view.camera_id)) is not None:
            yield whole
    if num_without := len(hands) - len(courses):
        yield Text(f"{kind}: {num_without} of {len(hands)} hands have no stored crop and cannot be shown.")


def _strip(kind: str, course: HandCourse, hand: _Rated, unit: str) -> Picture:
    sequence, frame, side = course.key
    figures = ", ".join(
        f"{method_label(name)} {value:.1f}" if np.isfinite(value) else f"{method_label(name)} missing"
        for name, value in hand.by_method.items()
    )
    caption = f"{kind}: {sequence}, frame {frame}, {side} hand, {course.view.camera_id}; {unit}: {figures}"
    return from_image(draw_strip(course, _TILE_PX), f"Crop of a hand by round. {caption}", caption)
