"""Which verb comes next: what is possible, and as often as designed."""

from collections import Counter

import numpy as np
import pytest

from assemblyhands_core.synthetic import activities
from assemblyhands_core.synthetic.activities import VERBS, options, write_script
from assemblyhands_core.synthetic.bench import Bench, Held, Segment
from assemblyhands_core.synthetic.grips import HandGrip
from assemblyhands_core.synthetic.person import Subject
from assemblyhands_core.synthetic.take import Take
from assemblyhands_core.synthetic.toys import draw_set


def test_an_empty_hand_takes_a_hand_with_a_part_puts_it_somewhere(bench: Bench) -> None:
    assert {option.verb for option in options(bench, True)} <= {"pick up", "remove", "screw", "unscrew"}
    wheel = next(n for n, p in bench.parts.parts.items() if p.noun == "wheel" and n not in bench.mounted)
    bench.held[bench.worker] = held(wheel)
    assert {option.verb for option in options(bench, True)} == {"position", "put down"}
    bench.held[bench.worker] = held("screwdriver")
    assert {option.verb for option in options(bench, True)} <= {"screw", "unscrew", "put down"}


def test_nothing_is_done_to_a_toy_that_nobody_holds(bench: Bench) -> None:
    del bench.held[bench.holder]
    bench.part_keys["chassis"].clear()
    bench.carry("chassis", "world", bench.part("chassis").resting(70.0, 60.0, 0.0, -20.0), 0.0)
    assert {option.verb for option in options(bench, True)} == {"pick up"}
    assert options(bench, True)[0].part == "chassis" and options(bench, True)[0].hand == bench.holder


def test_a_screwed_part_is_not_removed(built_bench: Bench) -> None:
    for option in options(built_bench, False):
        if option.verb == "remove":
            assert not built_bench.mounted_children(option.part) and not built_bench.is_tight(option.part)


def test_verbs_are_as_frequent_as_designed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The policy alone, with moves that only change the state: many takes in no time."""
    for name, stub in STUBS.items():
        monkeypatch.setattr(activities, name, stub)
    counts: Counter[str] = Counter()
    for seed in range(50):
        rng = np.random.default_rng(seed)
        bench = write_script(Subject.from_seed(seed), draw_set("assembly", rng), rng, 60.0)
        counts.update(segment.verb for segment in bench.segments)
    share = {verb: counts[verb] / counts.total() for verb in VERBS}
    designed = {"pick up": 0.35, "position": 0.18, "put down": 0.20, "remove": 0.09, "screw": 0.09, "unscrew": 0.09}
    assert share == pytest.approx(designed, abs=0.03)
    frequent, rare = [share["position"], share["put down"]], [share["remove"], share["screw"], share["unscrew"]]
    assert share["pick up"] > max(frequent) and min(frequent) > max(rare)
    # What is taken is put somewhere; at the end of each take at most one part per hand is still held.
    assert abs(counts["pick up"] + counts["remove"] - counts["position"] - counts["put down"]) <= 50 * 2


def test_screwing_lasts_and_the_rest_takes_a_second(take: Take, screwing_take: Take, desk_take: Take) -> None:
    lasting: dict[str, list[float]] = {verb: [] for verb in VERBS}
    for segment in (*take.segments, *screwing_take.segments, *desk_take.segments):
        lasting[segment.verb].append(segment.end_s - segment.start_s)
    assert {verb for verb, times in lasting.items() if times} == set(VERBS)
    assert min(lasting["screw"] + lasting["unscrew"]) > 1.5
    assert 0.6 < np.median([t for verb in VERBS[:4] for t in lasting[verb]]) < 2.5


def held(name: str) -> Held:
    return Held(name, np.eye(4), HandGrip(np.eye(4), np.zeros(20), np.zeros(20)))


def noted(bench: Bench, verb: str, name: str, hand: str, start_s: float, lasting_s: float) -> float:
    segment = Segment(verb, bench.part(name).noun, name, hand, start_s, start_s + lasting_s)  # type: ignore[arg-type]
    bench.segments.append(segment)
    return start_s + 1.7 * lasting_s


def _pick_up(bench: Bench, hand: str, name: str, t_s: float) -> float:
    bench.held[hand] = held(name)  # type: ignore[index]
    bench.carry(name, hand, np.eye(4), t_s)
    return noted(bench, "pick up", name, hand, t_s, 1.2)


def _put_down(bench: Bench, hand: str, t_s: float) -> float:
    name = bench.held.pop(hand).part  # type: ignore[call-overload]
    side = 200.0 if hand == "right" else -40.0
    bench.carry(name, "world", bench.part(name).resting(70.0, side, 0.0, -20.0), t_s)
    return noted(bench, "put down", name, hand, t_s, 1.0)


def _position(bench: Bench, t_s: float) -> float:
    name = bench.held.pop(bench.worker).part
    bench.mounted[name] = (0.0, bench.part(name).mount.travel_mm)  # type: ignore[union-attr]
    return noted(bench, "position", name, bench.worker, t_s, 1.4)


def _remove(bench: Bench, name: str, t_s: float) -> float:
    del bench.mounted[name]
    bench.held[bench.worker] = held(name)
    return noted(bench, "remove", name, bench.worker, t_s, 1.8)


def _turn_screw(bench: Bench, name: str, t_s: float, num_strokes: int) -> float:
    verb = "unscrew" if bench.is_tight(name) else "screw"
    out = bench.part(name).mount.travel_mm if bench.is_tight(name) else 0.0  # type: ignore[union-attr]
    bench.mounted[name] = (0.0, out)
    return noted(bench, verb, name, bench.worker, t_s, 1.1 * num_strokes)


STUBS = {
    "pick_up": _pick_up,
    "put_down": _put_down,
    "position": _position,
    "remove": _remove,
    "turn_screw": _turn_screw,
    "travel": lambda bench, hand, key: key.t_s,
}
