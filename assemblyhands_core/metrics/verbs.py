"""How well verbs are told from hand poses, by where the poses come from (paper, Sec. 5, Table 5, Fig. 6).

The paper's "Avg. Verb Acc." is not defined, and is not the mean of its six columns; both readings are given:
``accuracy`` is over all segments, ``mean_verb_accuracy`` the mean over verbs of each one's own. Shares are in percent.
Segments of one recording, and recordings of one person, go together: intervals draw these whole. Chance stands as two
rows beside the sources: always saying the verb that is most frequent among these segments, and guessing among all.
"""

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float

from assemblyhands_core.metrics.annotation import Cell, make_cell
from assemblyhands_core.metrics.bootstrap import (
    MIN_BLOCKS,
    BlockSums,
    Weights,
    difference_interval,
    draw_weights,
    mean_interval,
    percentile_bounds,
    ratio_interval,
)
from assemblyhands_core.metrics.run_differences import Difference, make_difference
from assemblyhands_core.metrics.verb_rows import Blocks, VerbRows, align_sources

TABLE: Final = "verbs"
TRUTH: Final = "truth"
MOST_FREQUENT: Final = "chance: most frequent verb"
UNIFORM: Final = "chance: uniform"
NO_PREDICTION: Final = "(none)"
"""What the confusion matrix calls segments without prediction; they count as wrong."""


@dataclass(frozen=True)
class VerbEvaluation:
    """How verbs are evaluated.

    Attributes:
        verbs: The classes, in the order of tables.
        upper_bound: The source that others are put in relation to; where it has no rows there is no relation.
        blocks: What intervals draw whole.
        num_resamples: How often all are drawn again.
        seed: Of the draws.
        num_bins: Equal steps of confidence, from 0 to 1, in which calibration is looked at.
        level: Share of the draws within an interval.
    """

    verbs: tuple[str, ...]
    upper_bound: str
    blocks: Blocks
    num_resamples: int
    seed: int
    num_bins: int = 10
    level: float = 0.95


def evaluate_verbs(predictions: pa.Table, evaluation: VerbEvaluation) -> list[Cell]:
    """Return the figures of every source.

    Args:
        predictions: A row for each segment and source: ``sequence_id``, ``segment``, ``source``, ``verb``,
            ``predicted`` (empty without prediction), ``confidence`` in [0, 1], ``pose_error_mm`` (NaN where unknown),
            ``coverage`` (observed hands, in percent).
        evaluation: How.

    Returns:
        Tables ``verbs`` (a row for each source and for chance), ``verbs_by_verb``, ``verbs_confusion`` (group: the true
        verb, metric: the predicted one), ``verbs_distribution``, ``verbs_calibration`` (group: bin of confidence) and
        ``verbs_comparison`` (pairs of sources). The coverage of a line is the mean of its segments' own.

    Raises:
        ValueError: Sources are not of the same segments, or a verb is none of the classes.
    """
    if not predictions.num_rows:
        return []
    sources = align_sources(predictions, evaluation.verbs, evaluation.upper_bound, evaluation.blocks)
    first = next(iter(sources.values()))
    figures = _Figures(evaluation, draw_weights(first.num_blocks, evaluation.num_resamples, evaluation.seed))
    cells: list[Cell] = []
    for name, rows in sources.items():
        cells += figures.overall(name, rows)
        cells += figures.by_verb(name, rows)
        cells += figures.confusion(name, rows)
        cells += figures.calibration(name, rows)
    return [*cells, *figures.chance(first), *figures.distribution(sources), *figures.comparison(sources)]


def verb_differences(first: pa.Table, second: pa.Table, evaluation: VerbEvaluation) -> Iterator[Difference]:
    """Yield the figures of one source of poses in two runs beside one another, over all segments and by verb.

    Args:
        first, second: As for `evaluate_verbs` without ``source``, of the same segments.
        evaluation: How.

    Raises:
        ValueError: They are not of the same segments, or a verb is none of the classes.
    """
    named = [
        table.append_column("source", pa.array([name] * table.num_rows, pa.string()))
        for name, table in (("first", first), ("second", second))
    ]
    if not first.num_rows:
        return
    runs = align_sources(pa.concat_tables(named), evaluation.verbs, "first", evaluation.blocks)
    weights = draw_weights(runs["first"].num_blocks, evaluation.num_resamples, evaluation.seed)
    yield from _Figures(evaluation, weights).differences(runs["first"], runs["second"])


@dataclass(frozen=True, eq=False)
class _Figures:
    """Lines of the tables, all from the same draws."""

    evaluation: VerbEvaluation
    weights: Weights

    def overall(self, name: str, rows: VerbRows) -> Iterator[Cell]:
        everywhere = np.ones(len(rows.true), dtype=bool)
        names = TABLE, "", name
        yield self._mean((*names, "accuracy"), rows, 100.0 * rows.is_right, everywhere)
        yield self._mean((*names, "pose_error_mm"), rows, rows.pose_error_mm, np.isfinite(rows.pose_error_mm))
        yield self._mean((*names, "pose_coverage"), rows, rows.coverage, everywhere)
        yield self._mean((*names, "confidence"), rows, 100.0 * rows.confidence, rows.is_confident)
        of_verbs = rows.accuracies()
        value = float(_over_verbs(of_verbs.mean()))
        yield self._cell((*names, "mean_verb_accuracy"), value, self._drawn(of_verbs), rows, everywhere)
        # Without interval: drawing segments again adds gaps of its own to every bin.
        error = calibration_error_percent(rows, self.evaluation.num_bins)
        yield Cell(*names, "calibration_error", error, np.nan, np.nan, int(rows.is_confident.sum()), _coverage(rows))

    def by_verb(self, name: str, rows: VerbRows) -> Iterator[Cell]:
        for place, verb in enumerate(self.evaluation.verbs):
            is_verb, names = np.asarray(rows.true == place), (f"{TABLE}_by_verb", verb, name)
            yield self._mean((*names, "accuracy"), rows, 100.0 * rows.is_right, is_verb)
            is_known = np.asarray(is_verb & np.isfinite(rows.pose_error_mm))
            yield self._mean((*names, "pose_error_mm"), rows, rows.pose_error_mm, is_known)

    def confusion(self, name: str, rows: VerbRows) -> Iterator[Cell]:
        predicted = [*enumerate(self.evaluation.verbs), *([(-1, NO_PREDICTION)] if (rows.predicted < 0).any() else [])]
        for true, verb in enumerate(self.evaluation.verbs):
            for place, metric in predicted:
                share = 100.0 * (rows.predicted == place)
                yield self._mean((f"{TABLE}_confusion", verb, name, metric), rows, share, rows.true == true)

    def calibration(self, name: str, rows: VerbRows) -> Iterator[Cell]:
        num_bins = self.evaluation.num_bins
        for number, is_member in enumerate(confidence_bins(rows, num_bins)):
            if is_member.any():
                names = f"{TABLE}_calibration", f"{number / num_bins:.2f} to {(number + 1) / num_bins:.2f}", name
                yield self._mean((*names, "confidence"), rows, 100.0 * rows.confidence, is_member)
                yield self._mean((*names, "accuracy"), rows, 100.0 * rows.is_right, is_member)
                yield self._mean((*names, "share"), rows, 100.0 * is_member, rows.is_confident)

    def chance(self, rows: VerbRows) -> Iterator[Cell]:
        everywhere = np.ones(len(rows.true), dtype=bool)
        counts = np.bincount(rows.true, minlength=rows.num_verbs)
        share = 100.0 * (rows.true == np.argmax(counts))
        yield self._mean((TABLE, "", MOST_FREQUENT, "accuracy"), rows, share, everywhere)
        known = ((MOST_FREQUENT, "mean_verb_accuracy", (counts > 0).sum()),)
        guessed = tuple((UNIFORM, metric, rows.num_verbs) for metric in ("accuracy", "mean_verb_accuracy"))
        for name, metric, num_choices in known + guessed:
            value = 100.0 / float(num_choices)
            yield Cell(TABLE, "", name, metric, value, np.nan, np.nan, len(rows.true), np.nan)

    def distribution(self, sources: Mapping[str, VerbRows]) -> Iterator[Cell]:
        first = next(iter(sources.values()))
        everywhere = np.ones(len(first.true), dtype=bool)
        said = {TRUTH: first.true} | {name: rows.predicted for name, rows in sources.items()}
        for place, verb in enumerate(self.evaluation.verbs):
            for name, verbs in said.items():
                names = f"{TABLE}_distribution", verb, name, "share"
                yield self._mean(names, sources.get(name, first), 100.0 * (verbs == place), everywhere)

    def comparison(self, sources: Mapping[str, VerbRows]) -> Iterator[Cell]:
        """Yield what each source loses or gains against those before it, and its share of the upper bound."""
        for before, after in itertools.combinations(sources, 2):
            pair = sources[after], sources[before]
            names = f"{TABLE}_comparison", "", f"{after} against {before}"
            everywhere, coverage = np.ones(len(pair[0].true), dtype=bool), _coverage(pair[0])
            right = [rows.sums(100.0 * rows.is_right, everywhere) for rows in pair]
            interval = difference_interval(right[0], right[1], self.weights, self.evaluation.level)
            yield make_cell((*names, "accuracy_difference"), interval, right[0], coverage)
            of_verbs = [rows.accuracies() for rows in pair]
            value, base = (_over_verbs(sums.mean()) for sums in of_verbs)
            drawn, drawn_base = (self._drawn(sums) for sums in of_verbs)
            metric = "mean_verb_accuracy_difference"
            yield self._cell((*names, metric), value - base, drawn - drawn_base, pair[0], everywhere)
            if before == self.evaluation.upper_bound:
                scaled = BlockSums(100.0 * right[0].total, right[0].count)
                interval = ratio_interval(scaled, right[1], self.weights, self.evaluation.level)
                yield make_cell((TABLE, "", after, "relative_accuracy"), interval, right[0], coverage)
                names = TABLE, "", after
                metric, shares = "relative_mean_verb_accuracy", _percent(drawn, drawn_base)
                yield self._cell((*names, metric), float(_percent(value, base)), shares, pair[0], everywhere)

    def differences(self, first: VerbRows, second: VerbRows) -> Iterator[Difference]:
        """Yield the figures of two runs beside one another."""
        runs, everywhere = (first, second), np.ones(len(first.true), dtype=bool)
        yield self._over_verbs_difference(first, second)
        right = [(100.0 * rows.is_right, everywhere) for rows in runs]
        errors = [(rows.pose_error_mm, np.isfinite(rows.pose_error_mm)) for rows in runs]
        coverage = [(rows.coverage, everywhere) for rows in runs]
        for metric, of_runs in (("accuracy", right), ("pose_error_mm", errors), ("pose_coverage", coverage)):
            one, other = (rows.sums(*amounts) for rows, amounts in zip(runs, of_runs, strict=True))
            yield make_difference((TABLE, "", metric), one, other, self.weights, self.evaluation.level)
        for place, verb in enumerate(self.evaluation.verbs):
            one, other = (rows.sums(100.0 * rows.is_right, first.true == place) for rows in runs)
            names = f"{TABLE}_by_verb", verb, "accuracy"
            yield make_difference(names, one, other, self.weights, self.evaluation.level)

    def _over_verbs_difference(self, first: VerbRows, second: VerbRows) -> Difference:
        one, other = first.accuracies(), second.accuracies()
        mean, mean_of_other = (float(_over_verbs(sums.mean())) for sums in (one, other))
        low, high = self._bounds(self._drawn(one) - self._drawn(other), first)
        figures = mean, mean_of_other, mean - mean_of_other, low, high
        return Difference(TABLE, "", "mean_verb_accuracy", *figures, len(first.true))

    def _mean(
        self,
        names: tuple[str, str, str, str],
        rows: VerbRows,
        amount: Float[np.ndarray, " row"],
        counts: Bool[np.ndarray, " row"],
    ) -> Cell:
        sums = rows.sums(amount, counts)
        interval = mean_interval(sums, self.weights, self.evaluation.level)
        return make_cell(names, interval, sums, _coverage(rows, counts))

    def _drawn(self, of_verbs: BlockSums) -> Float[np.ndarray, " resample"]:
        """Return the mean over verbs of every draw."""
        return np.asarray(_over_verbs(of_verbs.resampled_means(self.weights)))

    def _cell(
        self,
        names: tuple[str, str, str, str],
        value: float,
        drawn: Float[np.ndarray, " resample"],
        rows: VerbRows,
        counts: Bool[np.ndarray, " row"],
    ) -> Cell:
        """Return the line of a figure that is no mean of segments, with the percentiles of its draws."""
        return Cell(*names, float(value), *self._bounds(drawn, rows), int(counts.sum()), _coverage(rows, counts))

    def _bounds(self, drawn: Float[np.ndarray, " resample"], rows: VerbRows) -> tuple[float, float]:
        is_known = rows.num_blocks >= MIN_BLOCKS
        return percentile_bounds(drawn, self.evaluation.level) if is_known else (np.nan, np.nan)


def confidence_bins(rows: VerbRows, num_bins: int) -> list[Bool[np.ndarray, " row"]]:
    """Return which segments fall into each of so many equal steps of confidence, the lower bound included."""
    place = np.floor(np.where(rows.is_confident, rows.confidence, 0.0) * num_bins).clip(0, num_bins - 1)
    return [np.asarray(rows.is_confident & (place == number)) for number in range(num_bins)]


def calibration_error_percent(rows: VerbRows, num_bins: int) -> float:
    """Return the expected calibration error: the mean gap between confidence and accuracy, bins by their segments.

    Source: Guo et al., On Calibration of Modern Neural Networks (ICML 2017), Eq. 3. NaN without predictions.
    """
    if not rows.is_confident.any():
        return float("nan")
    surplus = np.where(rows.is_confident, rows.confidence, 0.0) - rows.is_right
    gaps = [abs(float(surplus[is_member].sum())) for is_member in confidence_bins(rows, num_bins)]
    return 100.0 * sum(gaps) / int(rows.is_confident.sum())


def _over_verbs(accuracies: Float[np.ndarray, "*any verb"]) -> Float[np.ndarray, "*any"]:
    """Return the mean over the verbs that occur."""
    return np.asarray(np.nanmean(accuracies, axis=-1))


def _percent(part: Float[np.ndarray, "*any"], whole: Float[np.ndarray, "*any"]) -> Float[np.ndarray, "*any"]:
    return np.asarray(100.0 * part / np.where(whole > 0, whole, np.nan))


def _coverage(rows: VerbRows, counts: Bool[np.ndarray, " row"] | None = None) -> float:
    chosen = rows.coverage if counts is None else rows.coverage[counts]
    return float(chosen.mean()) if chosen.size else float("nan")
